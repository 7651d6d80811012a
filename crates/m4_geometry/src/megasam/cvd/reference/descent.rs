//! The two stages, plainly.

use super::{DISPARITY, Problem, UNCERTAINTY, clamp, edge_weight, within};
use crate::megasam::cvd::settings::{ADAM_EPSILON, LEARNING_RATE, WEIGHTS};
use m4_core::Real;

/// Adam (Kingma and Ba) with decays 0.9 and 0.999.
#[derive(Debug, Clone)]
pub struct Adam<T> {
    m: Vec<T>,
    v: Vec<T>,
    steps: i32,
}

/// Decay of the first and of the second moment. MegaSaM (the defaults of Adam).
pub(in crate::megasam::cvd) const DECAY: [f64; 2] = [0.9, 0.999];

impl<T: Real> Adam<T> {
    /// Nothing seen yet.
    #[must_use]
    pub fn new(len: usize) -> Self {
        Self { m: vec![T::zero(); len], v: vec![T::zero(); len], steps: 0 }
    }

    /// One step; what is not a number in `gradient` counts as 0.
    pub fn step(&mut self, x: &mut [T], gradient: &[T], learning_rate: f64) {
        self.steps += 1;
        let [first, second] = DECAY.map(|beta| 1.0 - beta.powi(self.steps));
        let rate = T::of(learning_rate / first);
        let root = T::of(second.sqrt());
        let [b1, b2] = DECAY.map(T::of);
        for i in 0..x.len() {
            let g = if gradient[i].f64().is_nan() { T::zero() } else { gradient[i] };
            self.m[i] = b1 * self.m[i] + (T::one() - b1) * g;
            self.v[i] = b2 * self.v[i] + (T::one() - b2) * g * g;
            x[i] -= rate * self.m[i] / (self.v[i].sqrt() / root + T::of(ADAM_EPSILON));
        }
    }
}

/// Where the descent went.
#[derive(Debug, Clone)]
pub struct Trajectory<T> {
    /// Of the first stage, one per frame.
    pub log_scale: Vec<T>,
    /// Of the first stage, one per frame.
    pub shift: Vec<T>,
    /// `[frames][height][width]`.
    pub disparity: Vec<T>,
    /// `[frames][height][width]`, not clamped.
    pub uncertainty: Vec<T>,
    /// Before each step.
    pub losses: [Vec<T>; 2],
}

/// The disparity that the first stage looks at: `initial e^log_scale + shift` of each frame, inside its limits.
#[must_use]
pub fn seen_disparity<T: Real>(initial: &[T], log_scale: &[T], shift: &[T]) -> Vec<T> {
    affine(initial, log_scale, shift).into_iter().map(|d| clamp(d, DISPARITY)).collect()
}

fn affine<T: Real>(initial: &[T], log_scale: &[T], shift: &[T]) -> Vec<T> {
    let n = initial.len() / log_scale.len();
    let at = |(i, &d): (usize, &T)| d * log_scale[i / n].exp() + shift[i / n];
    initial.iter().enumerate().map(at).collect()
}

/// `steps` of both stages from `problem.initial` and `uncertainty`, which are taken in the unit that they have.
/// `problem.edge_weight` and the limits of `problem.initial` are set here.
#[must_use]
pub fn descend<T: Real>(problem: &Problem<T>, uncertainty: &[T], steps: [usize; 2]) -> Trajectory<T> {
    let mut problem = problem.clone();
    let (frames, n) = (problem.frames(), problem.width * problem.height);
    let start = problem.initial.clone();
    let weights = start.chunks_exact(n).map(|d| edge_weight(problem.width, problem.height, d));
    problem.edge_weight = weights.flatten().collect();
    problem.initial = start.iter().map(|&d| clamp(d, DISPARITY)).collect();
    let mut out = Trajectory {
        log_scale: vec![T::zero(); frames],
        shift: vec![T::zero(); frames],
        disparity: Vec::new(),
        uncertainty: uncertainty.to_vec(),
        losses: [Vec::new(), Vec::new()],
    };
    let mut adam = [Adam::new(frames), Adam::new(frames), Adam::new(start.len())];
    for _ in 0..steps[0] {
        let raw = affine(&start, &out.log_scale, &out.shift);
        let seen = seen_disparity(&start, &out.log_scale, &out.shift);
        let u: Vec<T> = out.uncertainty.iter().map(|&u| clamp(u, UNCERTAINTY)).collect();
        let total = problem.total(&seen, &u, &WEIGHTS[0]);
        out.losses[0].push(total.value);
        let (mut scale, mut shift) = (vec![T::zero(); frames], vec![T::zero(); frames]);
        for i in 0..raw.len() {
            if within(raw[i], DISPARITY) {
                scale[i / n] += total.disparity[i] * start[i] * out.log_scale[i / n].exp();
                shift[i / n] += total.disparity[i];
            }
        }
        adam[0].step(&mut out.log_scale, &scale, LEARNING_RATE[0]);
        adam[1].step(&mut out.shift, &shift, LEARNING_RATE[0]);
        let gradient = gated(&out.uncertainty, &total.uncertainty, UNCERTAINTY);
        adam[2].step(&mut out.uncertainty, &gradient, LEARNING_RATE[0]);
    }
    out.disparity = affine(&start, &out.log_scale, &out.shift);
    problem.initial =
        affine(&problem.initial, &out.log_scale, &out.shift).into_iter().map(|d| clamp(d, DISPARITY)).collect();
    let mut adam = [Adam::new(start.len()), Adam::new(start.len())];
    for _ in 0..steps[1] {
        let seen: Vec<T> = out.disparity.iter().map(|&d| clamp(d, DISPARITY)).collect();
        let u: Vec<T> = out.uncertainty.iter().map(|&u| clamp(u, UNCERTAINTY)).collect();
        let total = problem.total(&seen, &u, &WEIGHTS[1]);
        out.losses[1].push(total.value);
        let by_disparity = gated(&out.disparity, &total.disparity, DISPARITY);
        let by_uncertainty = gated(&out.uncertainty, &total.uncertainty, UNCERTAINTY);
        adam[0].step(&mut out.disparity, &by_disparity, LEARNING_RATE[1]);
        adam[1].step(&mut out.uncertainty, &by_uncertainty, LEARNING_RATE[1]);
    }
    out
}

/// A gradient with 0 where the variable is past its limits.
fn gated<T: Real>(x: &[T], gradient: &[T], limits: [f64; 2]) -> Vec<T> {
    let pairs = x.iter().zip(gradient);
    pairs.map(|(&x, &g)| if within(x, limits) { g } else { T::zero() }).collect()
}
