//! Splat and camera files that other tools play: one folder a format.
//!
//! A writer takes a [`m4_scene::Scene`], writes the file whole or not at all, and returns what it
//! wrote and what the format could not hold ([`Written`]). A format with one instant, or one a frame,
//! is given splats without time by [`instant`]. A reader takes untrusted bytes: whatever they are, it
//! returns a scene or an error that names the field, and allocates no more than a small multiple of
//! the file.
#![forbid(unsafe_code)]

mod instant;
mod written;

pub use instant::instant;
pub use written::{Loss, Written};
