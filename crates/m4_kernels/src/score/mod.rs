//! The time-weighted error of each splat (docs/spec/optimiser.md 4).
//!
//! For one frame and one plane of weights, `[height][width]` (the masked error of each pixel):
//!
//! ```text
//! score[i] = p_i(t) sum of weight[q] over the pixels q that splat i is composited on
//! ```
//!
//! *Composited* is what [`crate::blend`] says: `alpha >= ALPHA_MIN` and the pixel not finished. A
//! splat that reaches no pixel scores 0. Sums over frames and their factors (`1 / K`, the frame's
//! loss) are the caller's: a twin adds a frame's score to what is there.

#[cfg(feature = "gpu")]
pub mod gpu;
pub mod reference;
