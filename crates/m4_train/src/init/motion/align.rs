//! Aligns rigid pieces of a surface to another frame, by colour and depth (Gauss-Newton).

use crate::init::motion::{
    observed::{Observed, SurfacePoint},
    rigid::Rigid,
};
use m4_core::nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};
use rayon::prelude::*;

/// Noise of a measure of [`Observed`], as two frames show one point (our rule).
const MEASURE: f32 = 0.03;
/// Neighbouring pixels of a smoothed image that count as one (our rule).
const ALIKE: f32 = 5.0;
/// Differences of this many times their noise halve the trust in a point (our rules).
const OUTLIER: f32 = 3.0;
/// A point behind the surface by more than this many times the noise of depth is hidden.
const HIDDEN: f32 = 6.0;
/// Neighbours whose motions differ by this many times what is usual are of another piece: they
/// count half.
const ANOTHER_PIECE: f32 = 2.0;
/// A step turns by this at most, radians, and shifts by this at most, pixels: slopes hold no
/// farther.
const LONGEST: (f32, f32) = (0.3, 3.0);
/// Points that weigh less than this are left out.
const LEAST: f32 = 0.02;
/// How much of a piece counts: the fall of weights with the distance from its node, and the step
/// over its points.
pub(crate) type Extent = (f32, usize);
pub(super) const WIDE: Extent = (1.0, 2);
pub(super) const NARROW: Extent = (4.0, 2);

/// A place of a surface, and the points that move with it.
#[derive(Debug, Clone)]
pub(crate) struct Node {
    pub place: Vector3<f32>,
    /// Points around it: index, and half the squared distance over the squared radius of the piece.
    pub points: Vec<(u32, f32)>,
    /// The nodes around it.
    pub near: Vec<u32>,
}

/// The surface that is aligned.
#[derive(Debug)]
pub(crate) struct Pieces {
    pub nodes: Vec<Node>,
    pub points: Vec<SurfacePoint>,
    /// Distance between nodes, world units.
    pub spacing: f32,
    /// Pixels between points along rows and columns.
    pub step: usize,
}

/// What is known before a frame is looked at.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Prior {
    /// Standard deviation of depth, share of it.
    pub depth: f32,
    /// How far neighbours move apart, pixels.
    pub apart_px: f32,
    /// How far a step leads, pixels.
    pub step_px: f32,
}

/// Moves every node of `pieces` from its `guess` so that its points look in `frame` as they do in
/// their own.
///
/// A node minimises the squared differences of measures and depth at its points and the distances
/// of its motion from those of its neighbours (as rigid as possible, robust, so that joints bend);
/// steps are damped (Levenberg-Marquardt), so that what nothing tells keeps its guess. `rounds`
/// tells how wide pieces are in each round. All nodes take a step from the same state: the result
/// does not depend on the number of threads.
pub(crate) fn align(
    pieces: &Pieces,
    frame: &Observed,
    guess: &[Rigid],
    prior: Prior,
    rounds: &[Extent],
) -> Vec<Rigid> {
    let mut motion = guess.to_vec();
    for &extent in rounds {
        motion = (0..pieces.nodes.len())
            .into_par_iter()
            .map(|i| {
                let mut sums = Sums::default();
                let now = Moved::new(&pieces.nodes[i], &motion[i]);
                sums.points(pieces, i, &now, frame, prior.depth, extent);
                sums.neighbours(pieces, i, &now, frame, &motion, prior);
                sums.damp(pieces, &now, frame, prior);
                sums.step(&now, frame)
            })
            .collect();
    }
    motion
}

/// A node where its motion takes it.
pub(super) struct Moved<'a> {
    pub node: &'a Node,
    motion: &'a Rigid,
    pub place: Vector3<f32>,
}

impl<'a> Moved<'a> {
    pub fn new(node: &'a Node, motion: &'a Rigid) -> Self {
        Self {
            node,
            motion,
            place: motion.moved(&node.place),
        }
    }

    /// World units of a pixel there.
    pub fn pixel(&self, frame: &Observed) -> f32 {
        frame.pixel(frame.project(&self.place).map_or(1.0, |p| p.point[2]))
    }
}

/// How well the points of a node agree with a frame.
#[derive(Default)]
pub(super) struct Fit {
    squares: f32,
    visible: f32,
    all: f32,
}

impl Fit {
    fn add(&mut self, weight: f32, square: f32) {
        self.squares += weight * square / (1.0 + square / (OUTLIER * OUTLIER));
        self.visible += weight;
    }

    /// Returns the mean squared difference over its noise, [`OUTLIER`] squared at most and where
    /// nothing is visible.
    pub fn misfit(&self) -> f32 {
        if self.visible > 0.0 {
            self.squares / self.visible
        } else {
            OUTLIER * OUTLIER
        }
    }

    /// Returns the share of the points that the frame shows.
    pub fn visible(&self) -> f32 {
        self.visible / self.all.max(f32::MIN_POSITIVE)
    }
}

/// The normal equations of a shift and a turn about the moved node.
#[derive(Clone, Copy, Default)]
pub(super) struct Sums {
    /// Shift with shift, turn with shift, turn with turn.
    h: [Matrix3<f32>; 3],
    /// Of the shift and of the turn.
    b: [Vector3<f32>; 2],
}

impl Sums {
    /// Adds the squares `(r + g . (shift + turn x arm))^2`, summed to `outer = sum w g g^T` and
    /// `along = sum w r g`.
    #[inline]
    fn add(&mut self, outer: &Matrix3<f32>, along: &Vector3<f32>, arm: &Vector3<f32>) {
        // [arm]x outer and [arm]x outer [arm]x^T, without the zeros of the cross matrix
        let [x, y, z] = [arm.x, arm.y, arm.z];
        let o = |i: usize, j: usize| outer[(i, j)];
        let turned: [[f32; 3]; 3] = std::array::from_fn(|j| {
            [
                y * o(2, j) - z * o(1, j),
                z * o(0, j) - x * o(2, j),
                x * o(1, j) - y * o(0, j),
            ]
        });
        self.h[0] += outer;
        for i in 0..3 {
            let t = turned.map(|column| column[i]);
            (0..3).for_each(|j| self.h[1][(i, j)] += t[j]);
            self.h[2][(i, 0)] += y * t[2] - z * t[1];
            self.h[2][(i, 1)] += z * t[0] - x * t[2];
            self.h[2][(i, 2)] += x * t[1] - y * t[0];
        }
        self.b[0] -= along;
        self.b[1] -= arm.cross(along);
    }

    pub fn points(
        &mut self,
        pieces: &Pieces,
        i: usize,
        now: &Moved<'_>,
        frame: &Observed,
        depth: f32,
        (fall, step): Extent,
    ) -> Fit {
        let mut fit = Fit::default();
        let count = (ALIKE / (pieces.step * pieces.step) as f32).max(1.0) / step as f32;
        for &(k, d) in pieces.nodes[i].points.iter().step_by(step) {
            let near = (-fall * d).exp();
            if near < LEAST {
                // the nearest come first
                break;
            }
            fit.all += near;
            let point = &pieces.points[k as usize];
            let place = now.motion.moved(&point.place);
            let Some(projected) = frame.project(&place) else {
                continue;
            };
            let Some(sample) = frame.sample(projected.at) else {
                continue;
            };
            let noise = depth * projected.point[2];
            let behind = (sample.depth - projected.point[2]) / noise;
            let has_depth = sample.depth > 0.0;
            if has_depth && behind < -HIDDEN {
                continue;
            }
            let mut weight = near / count;
            if has_depth {
                weight *= trust(behind * behind);
            }
            let [du, dv, dz] = frame.jacobian(&projected);
            let off: [f32; 3] =
                std::array::from_fn(|c| (sample.measures[c] - point.measures[c]) / MEASURE);
            let square = (off[0] * off[0] + off[1] * off[1] + off[2] * off[2]) / 3.0;
            let of_measures = weight * trust(square) / 3.0;
            fit.add(near, square + if has_depth { behind * behind } else { 0.0 });
            let (mut outer, mut along) = (Matrix3::zeros(), Vector3::zeros());
            for c in 0..3 {
                let [a, b] = sample.slopes[c];
                let g = (du * a + dv * b) / MEASURE;
                along += g * (of_measures * off[c]);
                outer += (g * of_measures) * g.transpose();
            }
            if has_depth {
                let [a, b] = sample.depth_slope;
                let g = (du * a + dv * b - dz) / noise;
                along += g * (weight * behind);
                outer += (g * weight) * g.transpose();
            }
            self.add(&outer, &along, &(place - now.place));
        }
        fit
    }

    pub fn neighbours(
        &mut self,
        pieces: &Pieces,
        i: usize,
        now: &Moved<'_>,
        frame: &Observed,
        motion: &[Rigid],
        prior: Prior,
    ) {
        let near = &pieces.nodes[i].near;
        let noise = prior.apart_px * now.pixel(frame);
        for &j in near {
            let off = corners(pieces, now, &motion[j as usize]);
            let square =
                off.iter().map(|(off, _)| off.norm_squared()).sum::<f32>() / (4.0 * noise * noise);
            let weight = 0.5
                / (near.len() as f32 * noise * noise)
                / (1.0 + square / (ANOTHER_PIECE * ANOTHER_PIECE));
            self.corners(&off, weight);
        }
    }

    /// Damps the step.
    pub fn damp(&mut self, pieces: &Pieces, now: &Moved<'_>, frame: &Observed, prior: Prior) {
        let noise = prior.step_px * now.pixel(frame);
        self.corners(&corners(pieces, now, now.motion), 0.25 / (noise * noise));
    }

    fn corners(&mut self, off: &[(Vector3<f32>, Vector3<f32>); 4], weight: f32) {
        for (off, arm) in off {
            self.add(&(Matrix3::identity() * weight), &(off * weight), arm);
        }
    }

    fn matrix(&self) -> Matrix6<f64> {
        let mut h = Matrix6::<f64>::zeros();
        let [shift, mixed, turn] = self.h.map(|m| m.cast::<f64>());
        h.fixed_view_mut::<3, 3>(0, 0).copy_from(&shift);
        h.fixed_view_mut::<3, 3>(3, 0).copy_from(&mixed);
        h.fixed_view_mut::<3, 3>(0, 3).copy_from(&mixed.transpose());
        h.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        h
    }

    /// Standard deviation of the place in the image, pixels; `None` where it is not known at all.
    pub fn deviation(&self, now: &Moved<'_>, frame: &Observed) -> Option<f32> {
        let projected = frame.project(&now.place)?;
        let covariance: Matrix3<f64> = self.matrix().try_inverse()?.fixed_view::<3, 3>(0, 0).into();
        let covariance = covariance.cast::<f32>();
        let [du, dv, _] = frame.jacobian(&projected);
        Some(
            (du.dot(&(covariance * du)) + dv.dot(&(covariance * dv)))
                .max(0.0)
                .sqrt(),
        )
    }

    /// The motion after the step that the sums ask for.
    pub fn step(&self, now: &Moved<'_>, frame: &Observed) -> Rigid {
        let [a, b] = self.b;
        let Some(cholesky) = self.matrix().cholesky() else {
            return *now.motion;
        };
        let step = cholesky
            .solve(&Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z).cast::<f64>())
            .cast::<f32>();
        let limited = |v: Vector3<f32>, most: f32| v * (most / v.norm().max(most));
        let turn = limited(Vector3::new(step[3], step[4], step[5]), LONGEST.0);
        let shift = limited(
            Vector3::new(step[0], step[1], step[2]),
            LONGEST.1 * now.pixel(frame),
        );
        if !(turn.norm().is_finite() && shift.norm().is_finite()) {
            return *now.motion;
        }
        let mut rotation = UnitQuaternion::from_scaled_axis(turn) * now.motion.rotation;
        rotation.renormalize_fast();
        Rigid {
            rotation,
            from: now.node.place,
            to: now.place + shift,
        }
    }
}

/// How far two motions take the node, and three corners beside it, apart; and the arms of the
/// corners.
fn corners(pieces: &Pieces, now: &Moved<'_>, other: &Rigid) -> [(Vector3<f32>, Vector3<f32>); 4] {
    let axes = [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()];
    axes.map(|axis| {
        let p = now.node.place + axis * pieces.spacing;
        let mine = now.motion.moved(&p);
        (mine - other.moved(&p), mine - now.place)
    })
}

/// 1 where nothing differs, a quarter at [`OUTLIER`]; of a squared difference over its noise.
fn trust(square: f32) -> f32 {
    let t = 1.0 / (1.0 + square / (OUTLIER * OUTLIER));
    t * t
}

#[cfg(test)]
mod tests;
