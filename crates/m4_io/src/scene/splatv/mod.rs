//! `.splatv`: the file of the splaTV viewer, 64 bytes per splat.
//!
//! There is no specification; this is what the players `splaTV` and `gsplat.js` read. Numbers are
//! little-endian. The file is `0x674b` and the length of the JSON as `u32`, the JSON, and one texture
//! of `texwidth x texheight` texels of four `u32`:
//!
//! ```text
//! JSON    [{"type": "splat", "size": bytes, "texwidth": 4096, "texheight": rows, "cameras": [...]}]
//! word 0..3    mean at the middle of its life, 3 x f32, world units
//! word 3, 4    rotation (w, x, y, z), halves           word 5, 6    scales, 3 halves, world units
//! word 7       red, green, blue, opacity, a byte each
//! word 8..13   motion: 3 linear, 3 quadratic, 3 cubic coefficients, halves, world units per clip^n
//! word 13, 14  change of the rotation, 4 halves per clip  word 15      middle of its life, its length s
//! ```
//!
//! Time runs from 0 to 1; a splat is drawn with its opacity times `exp(-((t - middle) / s)^2)`, so that
//! `s` is the square root of 2 times our standard deviation, and not at all where that is below 0.02.
//! The tail of the last row of the texture is zeros. A camera is written as in the `cameras.json` of
//! 3DGS, with `cx`, `cy` and `time` besides; what else a scene knows is under the key `minute4d`.

mod header;
mod write;

#[cfg(test)]
mod tests;

pub use write::write;

/// First word of a file.
const MAGIC: u32 = 0x674b;
/// Bytes of a splat.
const SPLAT_BYTES: usize = 64;
/// Bytes of a texel.
const TEXEL_BYTES: usize = 16;
/// Texels in a row: 1024 splats.
const TEX_WIDTH: usize = 4096;
