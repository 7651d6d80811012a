//! The scalar that every reference kernel is generic over.

use nalgebra::RealField;

/// `f32` or `f64`.
///
/// The reference kernels are written once over this trait: in `f64` they are the oracle, in `f32`
/// they show what rounding alone costs.
pub trait Real: RealField + Copy + Default + Send + Sync + 'static {
    /// The nearest value to `x`.
    fn of(x: f64) -> Self;
    /// This value as `f64`, exact.
    fn f64(self) -> f64;
}

impl Real for f32 {
    fn of(x: f64) -> Self {
        x as f32
    }

    fn f64(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    fn of(x: f64) -> Self {
        x
    }

    fn f64(self) -> f64 {
        self
    }
}
