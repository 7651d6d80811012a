//! Converts the values of a video stream to sRGB.

mod encode;
mod matrix;
mod tone;

pub use encode::Planes420;
pub use matrix::{Range, YuvMatrix};
pub use tone::{Hdr, ToneMap};
