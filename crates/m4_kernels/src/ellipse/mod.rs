//! A splat on the image: an ellipse with an opacity, and its alpha at a pixel
//! (docs/spec/optimiser.md 1.7).
//!
//! ```text
//! d = centre - pixel
//! q = -(A00 dx^2 + A11 dy^2) / 2 - A01 dx dy        none if q > 0
//! alpha = min(ALPHA_MAX, opacity e^q)               none if alpha < ALPHA_MIN
//! ```
//!
//! Binning asks which pixels an ellipse reaches, blending what it adds to them; the projection
//! leaves out what can reach none.

pub mod reference;

/// The largest alpha: keeps `1 - alpha` away from 0 (3DGS).
pub const ALPHA_MAX: f64 = 0.99;
/// Contributions under this are skipped (3DGS): half a grey level of 8 bits has no effect.
pub const ALPHA_MIN: f64 = 1.0 / 255.0;
/// Base-2 logarithm of [`ALPHA_MIN`]: kernels compare exponents.
pub const LOG2_ALPHA_MIN: f64 = -7.994_353_436_858_858;
/// A pixel is finished before its transmittance would fall under this (3DGS).
pub const T_MIN: f64 = 1e-4;
