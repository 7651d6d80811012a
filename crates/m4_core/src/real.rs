//! The scalar that every reference kernel is generic over.

use nalgebra::RealField;
use std::cmp::Ordering;

/// `f32` or `f64`.
///
/// The reference kernels are written once over this trait: in `f64` they are the oracle, in `f32`
/// they show what rounding alone costs.
pub trait Real: RealField + Copy + Default + Send + Sync + 'static {
    /// The nearest value to `x`.
    fn of(x: f64) -> Self;
    /// This value as `f64`, exact.
    fn f64(self) -> f64;
    /// The total order of IEEE 754.
    fn order(&self, other: &Self) -> Ordering;
}

impl Real for f32 {
    fn of(x: f64) -> Self {
        x as f32
    }

    fn f64(self) -> f64 {
        f64::from(self)
    }

    fn order(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}

impl Real for f64 {
    fn of(x: f64) -> Self {
        x
    }

    fn f64(self) -> f64 {
        self
    }

    fn order(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}
