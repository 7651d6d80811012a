//! From the numbers in a video stream to sRGB.

mod matrix;
mod tone;

pub use matrix::{Range, YuvMatrix};
pub use tone::{Hdr, ToneMap};
