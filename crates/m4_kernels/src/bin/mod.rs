//! Ellipses to depth-ordered tile lists.
//!
//! The image is cut into square tiles of [`TILE`] pixels; the last column and row may be cut off by
//! the image's edge. A tile's list holds the splats that reach at least one pixel *of the image* in
//! it with `alpha >= ALPHA_MIN` ([`crate::blend`]), near to far, ties in the order of the rows. A
//! twin may list a splat in a tile that it does not reach, at a cost in time alone; it must not leave
//! one out (up to the rounding of `alpha` at the threshold).

pub(crate) mod cpu;
pub(crate) mod extent;
pub mod reference;

/// Edge of a tile, pixels: 8 keeps lanes busier than 16 (section 5.2).
pub const TILE: usize = 8;
