//! Scene files: `scene.safetensors` and those of other viewers, one folder per format.
//!
//! A writer takes a [`m4_core::Scene`], writes the file atomically, and returns what it
//! wrote and what the format could not hold ([`Written`]). A format with one instant, or one per frame,
//! is given splats without time by [`instant()`]. A reader takes untrusted bytes: whatever they are, it
//! returns a scene ([`Imported`]) or an error that names the field, and allocates no more than a small
//! multiple of the file.

pub mod fourdgs;
pub mod gltf;
pub mod ply;
pub mod safetensors;
pub mod splatv;
pub mod spz;

mod common;
mod rub;
mod splats;

pub use common::{DEFAULT_FPS, Imported, Loss, Written};
pub(crate) use common::{plural, usable};
pub use splats::{at_peak, instant};

/// The constant harmonic: a colour is `1/2 + C0` times the first coefficient (docs/spec/optimiser.md 1.8).
pub(crate) const C0: f64 = 0.282_094_791_773_878_14;
