//! Consistent video depth: one disparity map per frame, moved by gradient descent until the frames agree.
//!
//! ```text
//! pair_list -> flow both ways (caller) -> consistency_mask -> PairStore
//!                                                               |
//! poses, intrinsics, initial disparity, static confidence ------+-> optimise -> disparity, uncertainty
//!     stage 1: a scale and a shift per frame, and u    (100 Adam steps)
//!     stage 2: every pixel's disparity, and u        (400 Adam steps)
//! ```
//!
//! docs/spec/front-end.md 1.7, after MegaSaM (Li et al. 2024, section 3.3 and the released program). A
//! pair of frames i, j with flow: pixel p of i lands at q = p + flow in j; d_i(p) and the poses say where it should land and
//! how deep it should be there. The loss compares both, each times u_i(p), the pixel's certainty, which is learned
//! along: `error u + 0.25 log(1/u)`. Dynamic regions get a low u and keep their initial shape.
//!
//! - [`mod@reference`]: every loss term and its gradients, generic over f32 and f64: the definition.
//! - `fast`: the same in f32, fused, in vectors and threads; the same bits on any number of threads.
//! - [`pairs`]: the pairs' list, their masks, and their fields in a few bytes, on disk where memory ends.
//!
//! **Conventions.** The outside of this module is the library's: poses are `c2w`, the principal point is measured from the
//! corner of the image. Inside, as in the source, poses are `w2c` and pixel (0, 0) has its centre at (0, 0): [`optimise()`]
//! converts. The source computes normals half a pixel off its own reprojection; here both use the same rays, and
//! [`reference::Problem::normal_lens`] keeps the source's behaviour for comparisons.
//!
//! **Unit.** Disparities and poses come and go in the caller's unit (metres, if they are metres): nothing is normalised
//! away. Stage 1 fits a scale and a shift to each frame, which [`ConsistentDepth`] reports.

mod fast;
mod optimise;
pub mod pairs;
pub mod reference;
mod settings;

pub use optimise::{ConsistentDepth, optimise};
pub use settings::{CVD_STEPS, CvdError, CvdInput, PairError, Weights, uncertainty_of_static};

#[cfg(test)]
mod tests;
