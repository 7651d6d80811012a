//! What holds a disparity where the flow says little: a known depth, or damping.

use m4_core::Real;

/// Below this a sensor disparity counts as unknown.
pub const SENSOR_KNOWN: f64 = 1e-8;

/// Added to the curvature of every disparity, so that it can be inverted.
pub const CURVATURE_FLOOR: f64 = 1e-7;

/// `(added curvature, added gradient)` of one disparity (docs/spec/front-end.md 1.6):
/// with `m = 1` where the sensor knows the depth, `C += m alpha + (1 - m) eta + 1e-7` and
/// `b -= m alpha (d - d_sensor)`. `alpha = None` switches the prior off and leaves damping alone.
#[must_use]
#[inline(always)]
pub fn depth_prior<T: Real>(alpha: Option<T>, eta: T, disparity: T, sensor: T) -> (T, T) {
    let floor = T::of(CURVATURE_FLOOR);
    match alpha {
        Some(alpha) if sensor > T::of(SENSOR_KNOWN) => (alpha + floor, -alpha * (disparity - sensor)),
        _ => (eta + floor, T::zero()),
    }
}
