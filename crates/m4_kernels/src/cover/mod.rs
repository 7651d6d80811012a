//! Growth of dynamic splats that nothing but their opacity separates from the background (our rule;
//! docs/spec/optimiser.md 8.9).
//!
//! ```text
//! L = -weight * sum of opacity_i (log sd_i1 + log sd_i2 + log sd_i3)      over the dynamic splats that a frame touched
//! ```
//!
//! Splats of one scale for all directions count it once.
//!
//! Opacities are held fixed, and splats fainter than [`LEAST_OPACITY`] are left alone: they are
//! shadows and reflections.

pub mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod reference;

/// Splats of at most this opacity do not grow: through a shadow the background has to show.
pub const LEAST_OPACITY: f32 = 0.1;
