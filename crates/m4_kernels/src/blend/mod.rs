//! Alpha blending of splats, front to back, and its gradient (docs/spec/optimiser.md 1.7).
//!
//! For each pixel, splats near to far, `d = centre - pixel`, transmittance `T` from 1:
//!
//! ```text
//! q = -(A00 dx^2 + A11 dy^2) / 2 - A01 dx dy        skip if q > 0
//! alpha = min(ALPHA_MAX, opacity e^q)               skip if alpha < ALPHA_MIN
//! if T (1 - alpha) < T_MIN: stop; this splat is not blended
//! out += T alpha channel;  T *= 1 - alpha
//! rgb += T background after the last splat
//! ```
//!
//! Channels are red, green, blue, z-depth and 1 (whose sum is alpha, `1 - T`); the background adds to
//! the colours alone. An alpha that was cut at [`ALPHA_MAX`] passes no gradient to opacity and shape.
//!
//! The reference takes the gradient back to front; the twins *replay*, front to back with one scalar per pixel
//! (`sigma = <g, C>` less what was seen so far), which needs the final image alone and agrees to rounding.

pub(crate) mod cpu;
#[cfg(feature = "gpu")]
pub(crate) mod gpu;
pub(crate) mod planes;
pub mod reference;

/// The largest alpha: keeps `1 - alpha` away from 0 (3DGS).
pub const ALPHA_MAX: f64 = 0.99;
/// Contributions under this are skipped (3DGS): half a grey level of 8 bits has no effect.
pub const ALPHA_MIN: f64 = 1.0 / 255.0;
/// Base-2 logarithm of [`ALPHA_MIN`]: kernels compare exponents.
pub const LOG2_ALPHA_MIN: f64 = -7.994_353_436_858_858;
/// A pixel is finished before its transmittance would fall under this (3DGS).
pub const T_MIN: f64 = 1e-4;
