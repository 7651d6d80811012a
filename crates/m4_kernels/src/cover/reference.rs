//! The definition of the gradient.

use super::LEAST_OPACITY;
use m4_core::Real;

/// Derivative by each logarithmic scale of a touched dynamic splat with this opacity before the
/// sigmoid.
pub fn gradient<T: Real>(logit: T, weight: T) -> T {
    let opacity = T::one() / (T::one() + (-logit).exp());
    match opacity > T::of(f64::from(LEAST_OPACITY)) {
        true => -weight * opacity,
        false => T::zero(),
    }
}
