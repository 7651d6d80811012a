//! The loss, its gradients term by term, and the descent in two stages, in any precision: the
//! definition that the fast path agrees with.
//!
//! Arrays of pixels are `[frames][height][width]`, flat. Poses are `w2c`, pixel centres are whole
//! numbers.

mod terms;

use super::{ADAM_EPSILON, LEARNING_RATE, WEIGHTS, Weights};
use crate::dba::Pinhole;
use m4_core::{Real, Se3};
pub(super) use terms::{LOG_WEIGHT, blur_weights, reflect, relative};
pub use terms::{Pair, edge_weight, normal_loss, normals, pair_losses};

/// Disparities are kept inside this before anything uses them. MegaSaM: 1e-3 to 1e3.
pub const DISPARITY: [f64; 2] = [1e-3, 1e3];
/// The uncertainty u likewise. MegaSaM: 1e-4 to 1e3.
pub const UNCERTAINTY: [f64; 2] = [1e-4, 1e3];

/// What does not change during the descent.
#[derive(Debug, Clone)]
pub struct Problem<T: Real> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The camera at this size, with whole pixel centres.
    pub lens: Pinhole<T>,
    /// The camera that normals are computed with: `lens`, or that of MegaSaM, half a pixel off.
    pub normal_lens: Pinhole<T>,
    /// World to camera, one per frame.
    pub w2c: Vec<Se3<T>>,
    /// Flow between frames.
    pub pairs: Vec<Pair<T>>,
    /// `[frames][height][width]`: the disparity to keep the shape of.
    pub initial: Vec<T>,
    /// `[frames][height][width]`: weight of the normal term, [`edge_weight`] of the very first
    /// disparity.
    pub edge_weight: Vec<T>,
}

/// A loss term and its gradients, `[frames][height][width]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Term<T> {
    /// The loss.
    pub value: T,
    /// With respect to the disparity.
    pub disparity: Vec<T>,
    /// With respect to the uncertainty.
    pub uncertainty: Vec<T>,
}

impl<T: Real> Term<T> {
    fn zero(len: usize) -> Self {
        Self {
            value: T::zero(),
            disparity: vec![T::zero(); len],
            uncertainty: vec![T::zero(); len],
        }
    }

    fn add(&mut self, weight: f64, other: &Self) {
        let weight = T::of(weight);
        self.value += weight * other.value;
        for (a, &b) in self.disparity.iter_mut().zip(&other.disparity) {
            *a += weight * b;
        }
        for (a, &b) in self.uncertainty.iter_mut().zip(&other.uncertainty) {
            *a += weight * b;
        }
    }
}

impl<T: Real> Problem<T> {
    /// Frames.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.w2c.len()
    }

    /// The weighted sum of all terms at a disparity and uncertainty that are inside their limits.
    #[must_use]
    pub fn total(&self, disparity: &[T], uncertainty: &[T], weights: &Weights) -> Term<T> {
        let mut total = Term::zero(disparity.len());
        let [ratio, flow] = pair_losses(self, disparity, uncertainty);
        total.add(weights.ratio, &ratio);
        total.add(weights.flow, &flow);
        total.add(
            weights.scale_invariant,
            &scale_invariant_loss(self, disparity),
        );
        total.add(weights.gradient, &gradient_loss(self, disparity));
        total.add(weights.normal, &normal_loss(self, disparity));
        total
    }
}

/// `x` inside `limits`.
fn clamp<T: Real>(x: T, limits: [f64; 2]) -> T {
    x.max(T::of(limits[0])).min(T::of(limits[1]))
}

/// Whether a clamp lets the gradient through.
fn within<T: Real>(x: T, limits: [f64; 2]) -> bool {
    x >= T::of(limits[0]) && x <= T::of(limits[1])
}

/// -1, 0 or 1.
fn sign<T: Real>(x: T) -> T {
    if x > T::zero() {
        T::one()
    } else if x < T::zero() {
        -T::one()
    } else {
        T::zero()
    }
}

/// Every which pixel, for each scale. MegaSaM: four scales.
pub(super) const INTERVALS: [usize; 4] = [1, 2, 4, 8];

/// How much the central differences of `log(initial) - log(disparity)` are, at four scales (each a
/// nearest-exact subsampling): the sum over both directions and all scales of the mean of
/// `weight |difference|`.
///
/// The weight, a constant for the gradient, is `1 - exp(-5 |G(initial) - G(disparity)|)` where the
/// disparity is above 1 and 0 elsewhere; G is the sum of the absolute central differences of the
/// logarithm. So it acts on what is near, where shapes differ. A scale at which an image has less
/// than three pixels a side is left out.
#[must_use]
pub fn gradient_loss<T: Real>(problem: &Problem<T>, disparity: &[T]) -> Term<T> {
    let (width, n) = (problem.width, problem.width * problem.height);
    let mut term = Term::zero(disparity.len());
    for interval in INTERVALS {
        let (w, h) = (problem.width / interval, problem.height / interval);
        if w < 3 || h < 3 {
            continue;
        }
        let count = T::of((problem.frames() * (w - 2) * (h - 2)) as f64);
        for frame in 0..problem.frames() {
            let at = |x: usize, y: usize| {
                frame * n + (y * interval + interval / 2) * width + x * interval + interval / 2
            };
            for y in 1..h - 1 {
                for x in 1..w - 1 {
                    if disparity[at(x, y)] <= T::one() {
                        continue;
                    }
                    let ends = [[at(x - 1, y), at(x + 1, y)], [at(x, y - 1), at(x, y + 1)]];
                    let change = |log: &dyn Fn(usize) -> T| ends.map(|[a, b]| log(a) - log(b));
                    let initial = change(&|i| problem.initial[i].ln());
                    let current = change(&|i| disparity[i].ln());
                    let steep = |g: [T; 2]| g[0].abs() + g[1].abs();
                    let unlike = (steep(initial) - steep(current)).abs();
                    let weight = (T::one() - (-T::of(5.0) * unlike).exp()) / count;
                    for k in 0..2 {
                        let difference = initial[k] - current[k];
                        term.value += weight * difference.abs();
                        let pull = weight * sign(difference);
                        let [a, b] = ends[k];
                        term.disparity[a] -= pull / disparity[a];
                        term.disparity[b] += pull / disparity[b];
                    }
                }
            }
        }
    }
    term
}

/// The variance of `log(initial) - log(disparity)` within a frame, mean over frames.
#[must_use]
pub fn scale_invariant_loss<T: Real>(problem: &Problem<T>, disparity: &[T]) -> Term<T> {
    let n = problem.width * problem.height;
    let (pixels, frames) = (T::of(n as f64), T::of(problem.frames() as f64));
    let mut term = Term::zero(disparity.len());
    for frame in 0..problem.frames() {
        let range = frame * n..(frame + 1) * n;
        let difference = |i: usize| problem.initial[i].ln() - disparity[i].ln();
        let mean = range.clone().fold(T::zero(), |s, i| s + difference(i)) / pixels;
        for i in range {
            let off = difference(i) - mean;
            term.value += off * off / (pixels * frames);
            term.disparity[i] = -T::of(2.0) * off / (pixels * frames * disparity[i]);
        }
    }
    term
}

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
        Self {
            m: vec![T::zero(); len],
            v: vec![T::zero(); len],
            steps: 0,
        }
    }

    /// One step; what is not a number in `gradient` counts as 0.
    pub fn step(&mut self, x: &mut [T], gradient: &[T], learning_rate: f64) {
        self.steps += 1;
        let [first, second] = DECAY.map(|beta| 1.0 - beta.powi(self.steps));
        let rate = T::of(learning_rate / first);
        let root = T::of(second.sqrt());
        let [b1, b2] = DECAY.map(T::of);
        for i in 0..x.len() {
            let g = if gradient[i].f64().is_nan() {
                T::zero()
            } else {
                gradient[i]
            };
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

/// The disparity that the first stage looks at: `initial e^log_scale + shift` of each frame, inside
/// its limits.
#[must_use]
pub fn seen_disparity<T: Real>(initial: &[T], log_scale: &[T], shift: &[T]) -> Vec<T> {
    affine(initial, log_scale, shift)
        .into_iter()
        .map(|d| clamp(d, DISPARITY))
        .collect()
}

fn affine<T: Real>(initial: &[T], log_scale: &[T], shift: &[T]) -> Vec<T> {
    let n = initial.len() / log_scale.len();
    let at = |(i, &d): (usize, &T)| d * log_scale[i / n].exp() + shift[i / n];
    initial.iter().enumerate().map(at).collect()
}

/// `steps` of both stages from `problem.initial` and `uncertainty`, which are taken in the unit
/// that they have. `problem.edge_weight` and the limits of `problem.initial` are set here.
#[must_use]
pub fn descend<T: Real>(
    problem: &Problem<T>,
    uncertainty: &[T],
    steps: [usize; 2],
) -> Trajectory<T> {
    let mut problem = problem.clone();
    let (frames, n) = (problem.frames(), problem.width * problem.height);
    let start = problem.initial.clone();
    let weights = start
        .chunks_exact(n)
        .map(|d| edge_weight(problem.width, problem.height, d));
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
        let disparity = seen_disparity(&start, &out.log_scale, &out.shift);
        let u: Vec<T> = out
            .uncertainty
            .iter()
            .map(|&u| clamp(u, UNCERTAINTY))
            .collect();
        let total = problem.total(&disparity, &u, &WEIGHTS[0]);
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
    problem.initial = affine(&problem.initial, &out.log_scale, &out.shift)
        .into_iter()
        .map(|d| clamp(d, DISPARITY))
        .collect();
    let mut adam = [Adam::new(start.len()), Adam::new(start.len())];
    for _ in 0..steps[1] {
        let disparity: Vec<T> = out.disparity.iter().map(|&d| clamp(d, DISPARITY)).collect();
        let u: Vec<T> = out
            .uncertainty
            .iter()
            .map(|&u| clamp(u, UNCERTAINTY))
            .collect();
        let total = problem.total(&disparity, &u, &WEIGHTS[1]);
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
    pairs
        .map(|(&x, &g)| if within(x, limits) { g } else { T::zero() })
        .collect()
}
