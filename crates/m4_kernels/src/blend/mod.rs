//! Alpha blending of splats, front to back, and its gradient (docs/spec/optimiser.md 1.7).
//!
//! For each pixel, splats near to far, transmittance `T` from 1, with the alpha of
//! [`crate::ellipse`]:
//!
//! ```text
//! alpha of the splat at the pixel                   skip if there is none
//! if T (1 - alpha) < T_MIN: stop; this splat is not blended
//! out += T alpha channel;  T *= 1 - alpha
//! rgb += T background after the last splat
//! ```
//!
//! Channels are red, green, blue, z-depth and 1 (whose sum is alpha, `1 - T`); the background adds
//! to the colours alone. An alpha that was cut at [`ALPHA_MAX`](crate::ellipse::ALPHA_MAX) passes
//! no gradient to opacity and shape.
//!
//! The reference takes the gradient back to front; the twins *replay*, front to back with one
//! scalar per pixel (`sigma = <g, C>` less what was seen so far), which needs the final image alone
//! and agrees to rounding.

pub(crate) mod cpu;
#[cfg(feature = "gpu")]
pub(crate) mod gpu;
pub(crate) mod planes;
pub mod reference;
