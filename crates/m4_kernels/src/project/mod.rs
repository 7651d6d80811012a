//! Projects a 3D splat to an ellipse on the image (EWA; docs/spec/optimiser.md 0, 1.6).
//!
//! ```text
//! p_c = W m + T = (x, y, z)                      left out unless z > max(near, NEAR_MIN)
//! u = fx x / z + cx - 1/2, v = fy y / z + cy - 1/2        pixels, centre of the first pixel: 0, 0
//! kx = clamp(x / z, limits.x), ky = clamp(y / z, limits.y)        for the Jacobian only
//! J = [[fx / z, 0, -fx kx / z], [0, fy / z, -fy ky / z]]
//! V0 = J W S W^T J^T,  V = V0 + LOW_PASS I,  A = V^-1        the conic, 1 / pixels squared
//! compensation = sqrt(det V0 / det V) with the Mip filter, else 1
//! opacity = sigmoid(logit) p(t) compensation
//! ```
//!
//! The limits of the clamp ([`jacobian_limits`]) count as constants: no gradient flows through
//! them. A splat is left out when any of its centre, conic or opacity is not a finite number, or
//! its opacity is under [`crate::ellipse::ALPHA_MIN`]: it cannot reach a pixel.
//!
//! The camera's gradient is that of a left twist, `W <- exp([omega]) W`,
//! `T <- exp([omega]) T + tau`.

use m4_core::Intrinsics;

pub(crate) mod cpu;
#[cfg(feature = "gpu")]
pub(crate) mod gpu;
pub mod reference;

/// The smallest near plane, world units: a splat at depth 0 or behind has no image, whatever the
/// view says.
pub const NEAR_MIN: f64 = 1e-6;

/// Added to both diagonal entries of the image covariance, pixels squared (3DGS; a Gaussian of half
/// a pixel's standard deviation, roughly the pixel's own footprint).
pub const LOW_PASS: f64 = 0.3;

/// The Jacobian is evaluated within this multiple of the half field of view (3DGS).
pub const JACOBIAN_CLAMP: f64 = 1.3;

/// Range of `x / z` and `y / z` within which the Jacobian is evaluated:
/// `[x_min, x_max, y_min, y_max]`.
///
/// Each side reaches past its own image edge by `JACOBIAN_CLAMP - 1` times the half field of view's
/// tangent, so a centred principal point gives `JACOBIAN_CLAMP * tan(half field of view)` on every
/// side and an off-centre one keeps the same margin.
pub fn jacobian_limits(k: &Intrinsics) -> [f64; 4] {
    let (width, height) = (k.width as f64, k.height as f64);
    let margin = JACOBIAN_CLAMP - 1.0;
    let (x, y) = (
        margin * width / (2.0 * k.fx),
        margin * height / (2.0 * k.fy),
    );
    [
        -k.cx / k.fx - x,
        (width - k.cx) / k.fx + x,
        -k.cy / k.fy - y,
        (height - k.cy) / k.fy + y,
    ]
}
