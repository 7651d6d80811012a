//! Everything of a frame that no other frame has a part in: the shape terms, the sum of all
//! gradients, and Adam.

use super::edges::gradient_term;
use super::ln;
use super::shape::Shape;
use super::surface::sum;
use super::{edges, surface};
use crate::dba::Pinhole;
use crate::megasam::cvd::Weights;
use crate::megasam::cvd::reference::{DECAY, DISPARITY, UNCERTAINTY, edge_weight};

/// The variables of a frame, their moments, and what the terms compare with. Planes are plain
/// unless it says bordered.
#[derive(Debug)]
pub(super) struct Frame {
    /// In stage 1 the initial disparity; in stage 2 the variable. Not clamped.
    pub disparity: Vec<f32>,
    /// The variable, not clamped.
    pub uncertainty: Vec<f32>,
    /// Inside its limits: what the pairs see.
    pub seen_uncertainty: Vec<f32>,
    /// First and second moments of disparity (stage 2), then of uncertainty.
    moments: [Vec<f32>; 4],
    /// Of stage 1.
    pub log_scale: f64,
    /// Of stage 1.
    pub shift: f64,
    affine_moments: [[f64; 2]; 2],
    /// The disparity that the terms see, bordered.
    pub seen: Vec<f32>,
    /// Gradients of the pairs of which this frame is the source.
    pub by_disparity: Vec<f32>,
    /// Likewise.
    pub by_uncertainty: Vec<f32>,
    /// Gradients of the pairs of which this frame is the target, bordered.
    pub scatter: Vec<f32>,
    log_initial: Vec<f32>,
    /// Times the weight of the edges.
    initial_normals: [Vec<f32>; 3],
    edge_weight: Vec<f32>,
}

/// Which variables move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::megasam::cvd) enum Moves {
    /// A scale and a shift per frame.
    Affine,
    /// Every pixel.
    Pixels,
}

/// What all frames share in a step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step<'a> {
    pub shape: Shape,
    pub frames: usize,
    pub weights: &'a Weights,
    /// One over the number of pixels of pairs that count.
    pub pair_scale: f64,
    pub moves: Moves,
    pub rate: Rate,
}

/// Of one thread.
#[derive(Debug)]
pub(super) struct Scratch {
    surface: surface::Scratch,
    edges: edges::Scratch,
    off: Vec<f32>,
    pull: Vec<f32>,
    gradient: Vec<f32>,
    other: Vec<f32>,
}

impl Scratch {
    pub fn new(shape: Shape, lens: &Pinhole<f64>) -> Self {
        Self {
            surface: surface::Scratch::new(shape, lens),
            edges: edges::Scratch::default(),
            off: vec![0.0; shape.plain()],
            pull: vec![0.0; shape.plain()],
            gradient: vec![0.0; shape.width],
            other: vec![0.0; shape.width],
        }
    }
}

const LOW: f32 = DISPARITY[0] as f32;
const HIGH: f32 = DISPARITY[1] as f32;

impl Frame {
    /// From planes of `[height][width]`.
    pub fn new(shape: Shape, disparity: &[f32], uncertainty: &[f32]) -> Self {
        let plain = || vec![0.0; shape.plain()];
        let weight: Vec<f32> = edge_weight(shape.width, shape.height, disparity);
        Self {
            disparity: shape.spread(disparity, 1.0),
            uncertainty: shape.spread(uncertainty, 1.0),
            seen_uncertainty: vec![1.0; shape.plain()],
            moments: std::array::from_fn(|_| plain()),
            log_scale: 0.0,
            shift: 0.0,
            affine_moments: [[0.0; 2]; 2],
            seen: vec![0.0; shape.bordered()],
            by_disparity: plain(),
            by_uncertainty: plain(),
            scatter: vec![0.0; shape.bordered()],
            log_initial: plain(),
            initial_normals: std::array::from_fn(|_| plain()),
            edge_weight: shape.spread(&weight, 0.0),
        }
    }

    /// `scale disparity + shift` inside the limits into `seen`, and u inside its own into
    /// `seen_uncertainty`.
    #[inline(always)]
    pub fn look(&mut self, shape: Shape, scale: f32, shift: f32) {
        let [low, high] = UNCERTAINTY.map(|u| u as f32);
        for y in 0..shape.height {
            let row = &self.disparity[y * shape.stride..][..shape.width];
            let disparity = &mut self.seen[shape.tap_row(y)..][..shape.width];
            for x in 0..shape.width {
                let d = row[x] * scale + shift;
                let d = if d > LOW { d } else { LOW };
                disparity[x] = if d < HIGH { d } else { HIGH };
            }
        }
        for (target, &u) in self.seen_uncertainty.iter_mut().zip(&self.uncertainty) {
            let u = if u > low { u } else { low };
            *target = if u < high { u } else { high };
        }
    }

    /// Begins a stage: the disparity as it is seen now is the initial one from here on, and nothing
    /// has moved yet.
    #[inline(always)]
    pub fn begin(&mut self, shape: Shape, scratch: &mut Scratch) {
        self.look(shape, 1.0, 0.0);
        for y in 0..shape.height {
            let disparity = &self.seen[shape.tap_row(y)..][..shape.width];
            let out = &mut self.log_initial[y * shape.stride..][..shape.width];
            for x in 0..shape.width {
                out[x] = ln(disparity[x]);
            }
        }
        scratch.surface.weighted_normals(
            shape,
            &self.seen,
            &self.edge_weight,
            &mut self.initial_normals,
        );
        for plane in &mut self.moments {
            plane.fill(0.0);
        }
        self.affine_moments = [[0.0; 2]; 2];
        self.scatter.fill(0.0);
    }

    /// The weighted loss of the frame's own terms before the step, and the step; clears `scatter`
    /// for the next one.
    #[inline(always)]
    pub fn step(&mut self, step: &Step<'_>, scratch: &mut Scratch) -> f64 {
        let Step { shape, weights, .. } = *step;
        let (w, h) = (shape.width, shape.height);
        let pixels = shape.pixels() as f64;
        let all = pixels * step.frames as f64;

        let mut total = 0.0;
        for y in 0..h {
            let (disparity, initial) = (
                &self.seen[shape.tap_row(y)..][..w],
                &self.log_initial[y * shape.stride..][..w],
            );
            let off = &mut scratch.off[y * shape.stride..][..w];
            for x in 0..w {
                off[x] = initial[x] - ln(disparity[x]);
            }
            total += sum(off);
        }
        let mean = (total / pixels) as f32;
        let by_variance = 2.0 * weights.scale_invariant / all;
        let mut variance = 0.0;
        for y in 0..h {
            let row = y * shape.stride..y * shape.stride + w;
            let (off, pull) = (&scratch.off[row.clone()], &mut scratch.pull[row]);
            let (squares, rate) = (&mut scratch.other[..w], by_variance as f32);
            for x in 0..w {
                let d = off[x] - mean;
                squares[x] = d * d;
                pull[x] = rate * d;
            }
            variance += sum(squares);
        }
        let mut loss = weights.scale_invariant * variance / all;
        if weights.gradient > 0.0 {
            loss += gradient_term(
                shape,
                step.frames,
                weights.gradient,
                &scratch.off,
                &self.log_initial,
                &mut scratch.pull,
                &mut scratch.edges,
            );
        }
        let by_normal = weights.normal / all;
        loss += by_normal
            * scratch
                .surface
                .normal_term(shape, &self.seen, &self.initial_normals);
        self.advance(step, by_normal as f32, scratch);
        loss
    }

    /// Sums the gradients and moves the variables.
    #[inline(always)]
    fn advance(&mut self, step: &Step<'_>, by_normal: f32, scratch: &mut Scratch) {
        let (shape, w, rate) = (step.shape, step.shape.width, step.rate);
        let pair_scale = step.pair_scale as f32;
        let [low, high] = UNCERTAINTY.map(|u| u as f32);
        let (scale, shift) = (self.log_scale.exp() as f32, self.shift as f32);
        let [md, vd, mu, vu] = &mut self.moments;
        let mut affine = [0.0f64; 2];
        for y in 0..shape.height {
            let row = y * shape.stride..y * shape.stride + w;
            let taps = shape.tap_row(y)..shape.tap_row(y) + w;
            let (scaled, scatter) = (&self.seen[taps.clone()], &self.scatter[taps]);
            let (source, pull) = (&self.by_disparity[row.clone()], &scratch.pull[row.clone()]);
            let normal = scratch.surface.by_depth(shape, y);
            let disparity = &mut self.disparity[row.clone()];
            let gradient = &mut scratch.gradient[..w];
            let (raw_scale, raw_shift) = match step.moves {
                Moves::Affine => (scale, shift),
                Moves::Pixels => (1.0, 0.0),
            };
            for x in 0..w {
                let depth = 1.0 / scaled[x];
                let own = pull[x] + by_normal * normal[x] * depth;
                let g = pair_scale * (source[x] + scatter[x]) - depth * own;
                let raw = disparity[x] * raw_scale + raw_shift;
                gradient[x] = if (LOW..=HIGH).contains(&raw) { g } else { 0.0 };
            }
            match step.moves {
                Moves::Pixels => rate.row(
                    disparity,
                    &mut md[row.clone()],
                    &mut vd[row.clone()],
                    gradient,
                ),
                Moves::Affine => {
                    affine[1] += sum(gradient);
                    for x in 0..w {
                        gradient[x] *= disparity[x] * scale;
                    }
                    affine[0] += sum(gradient);
                }
            }
            let u = &mut self.uncertainty[row.clone()];
            let by_u = &self.by_uncertainty[row.clone()];
            for x in 0..w {
                let g = pair_scale * by_u[x];
                gradient[x] = if (low..=high).contains(&u[x]) { g } else { 0.0 };
            }
            rate.row(u, &mut mu[row.clone()], &mut vu[row], gradient);
        }
        self.scatter.fill(0.0);
        match step.moves {
            Moves::Pixels => self.look(shape, 1.0, 0.0),
            Moves::Affine => {
                let [scale, shift] = &mut self.affine_moments;
                rate.step(&mut self.log_scale, scale, affine[0]);
                rate.step(&mut self.shift, shift, affine[1]);
                let (scale, shift) = (self.log_scale.exp() as f32, self.shift as f32);
                self.look(shape, scale, shift);
            }
        }
    }

    /// The scale and the shift become part of the disparity.
    pub fn settle(&mut self) {
        let (scale, shift) = (self.log_scale.exp() as f32, self.shift as f32);
        for d in &mut self.disparity {
            *d = *d * scale + shift;
        }
    }
}

/// What all variables of a step share.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rate {
    /// Learning rate over the correction of the first moment.
    pub rate: f64,
    /// One over the root of the correction of the second moment.
    pub root: f64,
    pub epsilon: f64,
}

impl Rate {
    /// Of step `step`, from 1.
    pub fn new(learning_rate: f64, step: usize, epsilon: f64) -> Self {
        let step = i32::try_from(step).unwrap_or(i32::MAX);
        let [first, second] = DECAY.map(|beta| 1.0 - beta.powi(step));
        Self {
            rate: learning_rate / first,
            root: 1.0 / second.sqrt(),
            epsilon,
        }
    }

    /// One variable in double precision.
    pub fn step(&self, x: &mut f64, moments: &mut [f64; 2], gradient: f64) {
        let g = if gradient.is_nan() { 0.0 } else { gradient };
        let [m, v] = moments;
        *m = DECAY[0] * *m + (1.0 - DECAY[0]) * g;
        *v = DECAY[1] * *v + (1.0 - DECAY[1]) * g * g;
        *x -= self.rate * *m / (v.sqrt() * self.root + self.epsilon);
    }

    /// A row; all slices have one length. What is not a number in `g` counts as 0.
    #[inline(always)]
    pub fn row(&self, x: &mut [f32], m: &mut [f32], v: &mut [f32], g: &[f32]) {
        let n = x.len();
        let (m, v, g) = (&mut m[..n], &mut v[..n], &g[..n]);
        let [b1, b2] = DECAY.map(|b| b as f32);
        let [c1, c2] = DECAY.map(|b| (1.0 - b) as f32);
        let (rate, root, epsilon) = (self.rate as f32, self.root as f32, self.epsilon as f32);
        for i in 0..n {
            let g = if g[i].is_nan() { 0.0 } else { g[i] };
            m[i] = b1 * m[i] + c1 * g;
            v[i] = b2 * v[i] + c2 * g * g;
            x[i] -= rate * m[i] / (v[i].sqrt() * root + epsilon);
        }
    }
}
