//! The loss and its gradients, term by term, in any precision: the definition that the fast path agrees with.
//!
//! Arrays of pixels are `[frames][height][width]`, flat. Poses are `w2c`, pixel centres are whole numbers.

mod descent;
mod gradient;
mod normal;
mod pair;
mod variance;

pub(super) use descent::DECAY;
pub use descent::{Adam, Trajectory, descend, seen_disparity};
pub(super) use gradient::INTERVALS;
pub use gradient::gradient_loss;
pub(super) use normal::{blur_weights, reflect};
pub use normal::{edge_weight, normal_loss, normals};
pub(super) use pair::{LOG_WEIGHT, relative};
pub use pair::{Pair, pair_losses};
pub use variance::scale_invariant_loss;

use super::Weights;
use m4_core::{Real, Se3};

/// Disparities are kept inside this before anything uses them. MegaSaM: 1e-3 to 1e3.
pub const DISPARITY: [f64; 2] = [1e-3, 1e3];
/// The uncertainty u likewise. MegaSaM: 1e-4 to 1e3.
pub const UNCERTAINTY: [f64; 2] = [1e-4, 1e3];

/// A pinhole with whole pixel centres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole<T> {
    /// Horizontal focal length, pixels.
    pub fx: T,
    /// Vertical focal length, pixels.
    pub fy: T,
    /// Principal point, pixels from the centre of the first pixel.
    pub cx: T,
    /// Principal point, pixels from the centre of the first pixel.
    pub cy: T,
    /// Added to pixel coordinates where normals are computed. MegaSaM: 0.5; consistent with the reprojection: 0.
    pub normal_shift_px: T,
}

/// What does not change during the descent.
#[derive(Debug, Clone)]
pub struct Problem<T: Real> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The camera at this size.
    pub lens: Pinhole<T>,
    /// World to camera, one per frame.
    pub w2c: Vec<Se3<T>>,
    /// Flow between frames.
    pub pairs: Vec<Pair<T>>,
    /// `[frames][height][width]`: the disparity to keep the shape of.
    pub initial: Vec<T>,
    /// `[frames][height][width]`: weight of the normal term, [`edge_weight`] of the very first disparity.
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
        total.add(weights.scale_invariant, &scale_invariant_loss(self, disparity));
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
