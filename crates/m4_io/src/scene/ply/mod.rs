//! PLY files in the layout of 3DGS: one instant, or a folder with one file per frame.
//!
//! A file is a header of text and a table of 32-bit numbers, little-endian, a row per splat:
//!
//! ```text
//! x y z            mean, world units             nx ny nz         0
//! f_dc_0..2        constant colour coefficient: colour = 1/2 + C0 f_dc
//! f_rest_0..       the other harmonics, channel major: all of red, then green, then blue
//! opacity          logit                          scale_0..2       logarithms, world units
//! rot_0..3         quaternion (w, x, y, z)
//! ```
//!
//! Read are also: other orders of the properties, missing normals, harmonics of degree 0 to 3, one scale in
//! place of three, `red green blue` instead of coefficients, any number type, big-endian and text.

mod error;
mod header;
mod read;
mod sequence;
mod table;
mod write;

#[cfg(test)]
mod tests;

pub use error::ReadPlyError;
pub use read::{parse, read};
pub use sequence::{frame_name, write_sequence};
pub use write::write;
