//! `.4dgs`: splats with a velocity and a Gaussian in time, in chunks that can be sought (version 1).
//!
//! The model `gaussian-birth` is ours (docs/spec/optimiser.md 1.4): a centre that moves along a straight line, a
//! marginal in time that is cut off at 0.05, scales and a rotation that stay. Nothing is baked but the
//! harmonics of time. What the format has no field for (background, near plane, Mip filter, number of
//! frames) travels as a metadata record named `minute4d`, the cameras of the video as the format's own
//! sensor and rig records. The container itself is read and written by the `fourdgs` crate.
//!
//! | scene | file |
//! |---|---|
//! | frames | seconds, `duration_s / (time_frames - 1)` each; 1/30 s where the scene does not know |
//! | static splat | `sigma_t = inf`, no motion |
//! | colour `1/2 + C0 k` | "linear RGB" of 0..1: the value as it is, said to be `srgb-rec709-display` |
//! | harmonics of degree 1 to 3 | one byte each over -4..4, signs and order of 3DGS |
//! | quaternion (w, x, y, z) | (x, y, z, w) |
//! | world, y down | as it is; the coordinate frame record says so |

mod cameras;
mod convert;
mod notes;
mod read;
mod verify;
mod write;

#[cfg(test)]
mod tests;

pub use read::{parse, read};
pub use write::{FourdgsConfig, Precision, encode, write};
