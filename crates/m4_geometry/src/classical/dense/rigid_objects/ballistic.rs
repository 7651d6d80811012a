//! Ballistic prior: between two contacts the centre of an object moves along a parabola, with one
//! acceleration for all objects.
//!
//! ```text
//! tracklets -> observations: where the middle of a part is seen, and in which frames all of the part is
//!           -> the acceleration, first from the estimated depth of the parts
//!           -> flights: intervals of frames on one parabola  <-----------------------------------------------.
//!           -> the acceleration from the motion of the camera, and from the ground that nothing falls through --'
//!           -> depth by frame
//! ```
//!
//! The rays to an object on a parabola `p + u t + g t^2 / 2` say where it is once `g` is known:
//! every frame gives two linear equations for the six unknowns of `p` and `u`. Down is the normal
//! of the ground; the acceleration, in the unit of the cameras per frame squared, is one number for
//! the whole clip. Needs neither size nor shape, but a ground and a curved path.

use super::ground::Ground;
use super::silhouette::{radius_px, silhouettes};
use super::{Flight, Tracklet, WorkingClip, flight};
use crate::FrameRate;
use m4_core::{Camera, quantile};
use nalgebra::{Matrix6, Vector3, Vector6};

/// Least time in flight, of all objects together, for the prior to be used, seconds.
const LEAST_IN_FLIGHT_S: f64 = 2.0 / 3.0;
/// How often flights and the acceleration are found in turn.
const ROUNDS: usize = 3;
/// The sizes that two flights of one part imply may differ by less than this factor.
const SIZE_RATIO: f32 = 1.3;
/// The mean depth of what is seen of an object is nearer than its middle by this share of its
/// radius: two thirds for a ball.
const BULGE: f64 = 0.6;

/// An object that may be in flight.
pub(super) struct RigidObject<'a> {
    pub rate: FrameRate,
    /// Of its frames.
    pub cameras: &'a [Camera],
    pub observations: Vec<Observation>,
    /// Its estimated z-depth, by frame.
    pub depth: &'a [f64],
}

/// The z-depth of objects in flight, by part and frame: of their visible side, not of their middle.
/// `None` where nothing is in flight.
///
/// `depth` is the estimated z-depth of each part by frame, of which only the order of magnitude
/// matters.
pub(super) fn depths(
    clip: &WorkingClip<'_>,
    ground: &Ground,
    tracklets: &[&Tracklet],
    depth: &[Vec<f64>],
) -> Option<Vec<Vec<Option<f64>>>> {
    let objects: Vec<RigidObject<'_>> = tracklets
        .iter()
        .zip(depth)
        .map(|(t, depth)| RigidObject {
            rate: clip.rate,
            cameras: &clip.cameras[t.first..t.first + t.parts.len()],
            observations: observations(clip, t),
            depth,
        })
        .collect();
    let mut g = flight::first_acceleration(&objects, ground)?;
    let mut flights = Vec::new();
    for _ in 0..ROUNDS {
        flights = flight::find(&objects, ground, g);
        if flights.iter().flatten().map(Flight::frames).sum::<usize>()
            < clip.rate.frames(LEAST_IN_FLIGHT_S)
        {
            return None;
        }
        g = flight::settled_acceleration(&objects, &flights, ground)?;
    }
    let along = |object: &RigidObject<'_>, flights: &[Flight]| {
        let mut out = vec![None; object.depth.len()];
        if one_size(object, flights, ground, g) {
            for flight in flights {
                for (k, out) in out
                    .iter_mut()
                    .enumerate()
                    .take(flight.end)
                    .skip(flight.first)
                {
                    let z = flight.parabola.depth(&object.cameras[k], k, ground, g);
                    *out = Some(z * (1.0 - BULGE * object.observations[k].radius));
                }
            }
        }
        out
    };
    Some(
        objects
            .iter()
            .zip(&flights)
            .map(|(object, f)| along(object, f))
            .collect(),
    )
}

/// Whether a part keeps its size from flight to flight; two things whose images touch may not.
fn one_size(object: &RigidObject<'_>, flights: &[Flight], ground: &Ground, g: f64) -> bool {
    let size = |flight: &Flight| {
        let mut all: Vec<f32> = (flight.first..flight.end)
            .filter(|&k| object.observations[k].complete)
            .map(|k| {
                (object.observations[k].radius
                    * flight.parabola.depth(&object.cameras[k], k, ground, g))
                    as f32
            })
            .collect();
        quantile(&mut all, 0.5)
    };
    let sizes: Vec<f32> = flights.iter().filter_map(size).collect();
    let least = sizes.iter().copied().fold(f32::INFINITY, f32::min);
    sizes.iter().all(|s| *s < SIZE_RATIO * least)
}

/// What one frame shows of a part.
pub(super) struct Observation {
    /// Two directions in the world, across the ray to the middle: their product with the vector
    /// from the camera to a point of depth 1 is the distance of the point from the middle in the
    /// image, pixels at the working size.
    pub across: [Vector3<f64>; 2],
    /// Of a disc of the same area, over the focal length.
    pub radius: f64,
    /// The same in pixels.
    pub radius_px: f64,
    /// All of the part is in the image and nothing is in front of it, as far as one can tell.
    pub complete: bool,
}

/// By frame of the tracklet.
fn observations(clip: &WorkingClip<'_>, tracklet: &Tracklet) -> Vec<Observation> {
    silhouettes(clip, tracklet)
        .iter()
        .enumerate()
        .map(|(k, silhouette)| {
            let camera = &clip.cameras[tracklet.first + k];
            let lens = &camera.intrinsics;
            let radius_px = radius_px(silhouette.area);
            let [u, v] = [silhouette.middle.x + 0.5, silhouette.middle.y + 0.5];
            Observation {
                across: [
                    camera.c2w.rotation * Vector3::new(lens.fx, 0.0, lens.cx - u),
                    camera.c2w.rotation * Vector3::new(0.0, lens.fy, lens.cy - v),
                ],
                radius: radius_px / lens.fx,
                radius_px,
                complete: silhouette.complete,
            }
        })
        .collect()
}

/// Fewest frames in which the whole object is seen.
const LEAST_COMPLETE: usize = 6;
/// Solutions, each weighted by the depths of the one before.
const SOLUTIONS: usize = 4;
/// Depths that differ from the estimated one by more than this factor are a failure.
const RANGE: f64 = 20.0;

/// The parabola through the rays to an object, affine in the acceleration.
#[derive(Clone)]
pub(super) struct Parabola {
    /// The frame, counted from the object's first, that position and velocity belong to.
    middle: f64,
    /// Position and velocity per frame without acceleration, and what an acceleration of 1 adds to
    /// them.
    without_acceleration: Vector6<f64>,
    per_acceleration: Vector6<f64>,
    /// Root mean square distance of the middles from it, pixels at the working size.
    pub residual_px: f64,
    /// Frames in which the whole object is seen.
    pub n_frames: usize,
    /// Standard deviation of the depth for a pixel of noise, as a share of it.
    pub depth_sigma: f64,
    /// The acceleration that fits best, and one over its variance for a pixel of noise.
    pub best_acceleration: f64,
    pub information: f64,
}

impl Parabola {
    /// Fits the parabola of frames `first..end` at the acceleration `g`; `None` if too little is
    /// seen.
    pub fn fit(
        object: &RigidObject<'_>,
        (first, end): (usize, usize),
        ground: &Ground,
        g: f64,
    ) -> Option<Self> {
        let middle = (first + end - 1) as f64 / 2.0;
        let usual = object.depth[first..end].iter().sum::<f64>() / (end - first) as f64;
        let mut z = vec![usual; end - first];
        let mut out = None;
        for _ in 0..SOLUTIONS {
            let parabola = Self::solve(object, (first, middle), &z, ground, g)?;
            for (k, z) in (first..end).zip(&mut z) {
                *z = parabola.depth(&object.cameras[k], k, ground, g);
                if !(*z > usual / RANGE && *z < usual * RANGE) {
                    return None;
                }
            }
            out = Some(parabola);
        }
        out
    }

    /// One solution, `z` being the depths by frame from `first` on.
    fn solve(
        object: &RigidObject<'_>,
        (first, middle): (usize, f64),
        z: &[f64],
        ground: &Ground,
        g: f64,
    ) -> Option<Self> {
        let (mut a, mut without_acceleration, mut per_acceleration) =
            (Matrix6::zeros(), Vector6::zeros(), Vector6::zeros());
        let mut rows = Vec::new();
        for (i, z) in z
            .iter()
            .enumerate()
            .filter(|(i, _)| object.observations[first + i].complete)
        {
            let k = first + i;
            let t = k as f64 - middle;
            let c = object.cameras[k].centre();
            for across in &object.observations[k].across {
                let e = across / *z;
                let mut row = Vector6::zeros();
                row.fixed_rows_mut::<3>(0).copy_from(&e);
                row.fixed_rows_mut::<3>(3).copy_from(&(e * t));
                let (b, d) = (e.dot(&c), -0.5 * t * t * e.dot(&ground.down));
                a += row * row.transpose();
                without_acceleration += row * b;
                per_acceleration += row * d;
                rows.push((row, b, d));
            }
        }
        if rows.len() < 2 * LEAST_COMPLETE {
            return None;
        }
        let solver = a.cholesky()?;
        let (without_acceleration, per_acceleration) = (
            solver.solve(&without_acceleration),
            solver.solve(&per_acceleration),
        );
        let (mut off, mut cross, mut information) = (0.0, 0.0, 0.0);
        for (row, b, d) in &rows {
            let (rc, rg) = (
                row.dot(&without_acceleration) - b,
                row.dot(&per_acceleration) - d,
            );
            off += (rc + g * rg).powi(2);
            cross += rc * rg;
            information += rg * rg;
        }
        let at = z.len() / 2;
        let ahead = (object.cameras[first + at].c2w.rotation * Vector3::z()) / z[at];
        let place = solver.inverse().fixed_view::<3, 3>(0, 0).into_owned();
        Some(Self {
            middle,
            without_acceleration,
            per_acceleration,
            residual_px: (2.0 * off / rows.len() as f64).sqrt(),
            n_frames: rows.len() / 2,
            depth_sigma: ahead.dot(&(place * ahead)).sqrt(),
            best_acceleration: -cross / information.max(1e-30),
            information,
        })
    }

    /// The middle of the object in frame `k` at the acceleration `g`.
    pub fn at(&self, k: usize, ground: &Ground, g: f64) -> Vector3<f64> {
        let t = k as f64 - self.middle;
        let x = self.without_acceleration + self.per_acceleration * g;
        x.fixed_rows::<3>(0) + x.fixed_rows::<3>(3) * t + ground.down * (0.5 * g * t * t)
    }

    /// Its z-depth in the camera of that frame.
    pub fn depth(&self, camera: &Camera, k: usize, ground: &Ground, g: f64) -> f64 {
        camera.w2c().transform(&self.at(k, ground, g)).z
    }
}
