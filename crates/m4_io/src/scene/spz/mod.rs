//! SPZ, the compressed splats of Niantic (version 3): one instant, about 10 bytes per splat.
//!
//! A gzip stream of a header of 16 bytes and then one block per parameter, little-endian:
//!
//! ```text
//! u32 0x5053474e ("NGSP"), u32 version, u32 n, u8 sh_degree, u8 fractional_bits, u8 flags, u8 0
//! positions   n x 3 x i24    fixed point: steps of 2^-fractional_bits
//! alphas      n x u8         opacity x 255
//! colours     n x 3 x u8     (0.15 c + 0.5) x 255 of the harmonic of degree 0
//! scales      n x 3 x u8     (ln scale + 10) x 16
//! rotations   n x u32        smallest three: index of the largest of (x, y, z, w) in the upper 2 bits,
//!                            then 3 x 10 bits of sign and magnitude, steps of 1/sqrt(2)/511
//! harmonics   n x k x 3 x u8 128 c + 128, k = (degree + 1)^2 - 1
//! ```
//!
//! Flag 1 says that splats were trained with the opacity-compensated filter. By convention worlds are
//! right, up, back (RUB); `splat-transform` 3.7 expects the axes of a PLY instead.
//! Version 4 (streams of zstd) is not written: fewer players know it.
//!
//! Source: the README of `nianticlabs/spz`.

mod encode;
mod layout;
mod write;

pub use write::write;
