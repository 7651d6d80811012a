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

pub(crate) mod cameras_check;
mod clock;
mod file;
mod file_error;
mod instant;
mod peak;
mod row;
mod rub;
mod verified;
mod words;
mod written;

pub use clock::DEFAULT_FPS;
pub use file_error::WriteFileError;
pub use instant::instant;
pub use peak::at_peak;
pub use written::{Imported, Loss, Written};

pub(crate) use words::plural;

/// The constant harmonic: a colour is `1/2 + C0` times the first coefficient (docs/spec/optimiser.md 1.8).
pub(crate) const C0: f64 = 0.282_094_791_773_878_14;
