//! `scene.safetensors`: a trained scene in full precision, and the state of its training.
//!
//! A safetensors file, so that any language reads the arrays:
//!
//! ```text
//! splats.mean         f32 [n, 3]            static splats first; units as in m4_core::Column
//! splats.log_scale    f32 [n, 3] or [n, 1]
//! splats.quat         f32 [n, 4]            (w, x, y, z); absent for isotropic splats
//! splats.opacity      f32 [n]               logit
//! splats.colour       f32 [n, time_degree + 1, (sh_degree + 1)^2, 3]
//! splats.time_mean    f32 [dynamic]         frames
//! splats.log_time_sd  f32 [dynamic]
//! splats.velocity     f32 [dynamic, 3]
//! source.intrinsics   f64 [frames, 6]       width, height, fx, fy, cx, cy
//! source.c2w          f64 [frames, 3, 4]    OpenCV axes
//! source.t            f64 [frames]          frames
//! source.exposure     f32 [frames, 3, 4]    matrix, offset
//! state.NAME          any                   what training handed over, as it was
//! ```
//!
//! The metadata has one key, `minute4d_scene`: JSON with the version of the format, what is not an
//! array (background, near, ...), the caller's own key-value pairs, and a BLAKE3 checksum over all of
//! it, which is compared on every read.

mod convert;
mod read;
mod tensor;
mod write;

pub use read::{SceneFile, read};
pub use write::write;
