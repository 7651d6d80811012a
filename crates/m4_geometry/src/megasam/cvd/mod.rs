//! Consistent video depth: one disparity map per frame, moved by gradient descent until the frames
//! agree.
//!
//! ```text
//! pair_list -> flow both ways (caller) -> consistency_mask -> PairStore
//!                                                               |
//! poses, intrinsics, initial disparity, static confidence ------+-> optimise -> disparity, uncertainty
//!     stage 1: a scale and a shift per frame, and u    (100 Adam steps)
//!     stage 2: every pixel's disparity, and u        (400 Adam steps)
//! ```
//!
//! docs/spec/front-end.md 1.7, after MegaSaM (Li et al. 2024, section 3.3 and the released
//! program). A pair of frames i, j with flow: pixel p of i lands at q = p + flow in j; d_i(p) and
//! the poses say where it should land and how deep it should be there. The loss compares both, each
//! times u_i(p), the pixel's certainty, which is learned along: `error u + 0.25 log(1/u)`. Dynamic
//! regions get a low u and keep their initial shape.
//!
//! - [`mod@reference`]: every loss term and its gradients, generic over f32 and f64: the
//!   definition.
//! - `fast`: the same in f32, fused, in vectors and threads; the same bits on any number of
//!   threads.
//! - [`pairs`]: the pairs' list, their masks, and their fields in a few bytes, on disk where memory
//!   ends.
//!
//! **Conventions.** The outside of this module is the library's: poses are `c2w`, the principal
//! point is measured from the corner of the image. Inside, as in the source, poses are `w2c` and
//! pixel (0, 0) has its centre at (0, 0): [`optimise()`] converts. The source computes normals half
//! a pixel off its own reprojection; here both use the same rays, and
//! [`reference::Problem::normal_lens`] keeps the source's behaviour for comparisons.
//!
//! **Unit.** Disparities and poses come and go in the caller's unit (metres, if they are metres):
//! nothing is normalised away. Stage 1 fits a scale and a shift to each frame, which
//! [`ConsistentDepth`] reports.

mod fast;
mod optimise;
pub mod pairs;
pub mod reference;
#[cfg(test)]
mod tests;

use m4_core::{Intrinsics, Plane, Se3};
pub use optimise::{ConsistentDepth, optimise};

/// Weights of the loss terms (docs/spec/front-end.md 1.7).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// Ratio of reprojected and sampled disparity. MegaSaM: 1.
    pub ratio: f64,
    /// Distance of the reprojected pixel from where the flow leads, pixels. MegaSaM: 0.2.
    pub flow: f64,
    /// Variance of the log ratio of initial and current disparity. MegaSaM: 1.
    pub scale_invariant: f64,
    /// Gradients of that log ratio at four scales. MegaSaM: 2.
    pub gradient: f64,
    /// Angle between the normals of initial and current depth. MegaSaM: 4 in stage 1, 5 in stage 2.
    pub normal: f64,
}

impl Weights {
    /// Weights of the first stage.
    pub const STAGE1: Self = Self {
        normal: 4.0,
        ..Self::STAGE2
    };
    /// Weights of the second stage.
    pub const STAGE2: Self = Self {
        ratio: 1.0,
        flow: 0.2,
        scale_invariant: 1.0,
        gradient: 2.0,
        normal: 5.0,
    };
}

/// Weights of both stages.
const WEIGHTS: [Weights; 2] = [Weights::STAGE1, Weights::STAGE2];
/// Learning rate of every variable, by stage. MegaSaM: 1e-2 and 5e-3.
const LEARNING_RATE: [f64; 2] = [1e-2, 5e-3];
/// Added to the root of the second moment. 1e-8: MegaSaM (the default of Adam). Gradients are means
/// over all pixels of all frames, about one over their number.
const ADAM_EPSILON: f64 = 1e-8;
/// The 98th percentile of the initial disparity during the optimisation. The loss knows lengths
/// (learning rates, depth limits, "near" = disparity above 1), and MegaSaM chose them for
/// disparities normalised to a 98th percentile of 2. Poses and disparities are scaled on the way in
/// and back on the way out, so results are in the caller's unit either way.
const WORKING_PERCENTILE_98: f64 = 2.0;

/// Adam steps of the first stage (scale and shift of each frame, and u) and of the second (the
/// disparity of each pixel, and u). MegaSaM: 100 and 400.
pub const CVD_STEPS: [usize; 2] = [100, 400];

/// Poses, camera, disparity and certainty of a clip, all frames of one size.
#[derive(Debug, Clone, Copy)]
pub struct CvdInput<'a> {
    /// Camera to world, one per frame; held fixed.
    pub c2w: &'a [Se3<f64>],
    /// Of every frame, at the size of `disparity`.
    pub intrinsics: Intrinsics,
    /// One over z-depth, one plane per frame, in the unit of the poses; positive.
    pub disparity: &'a [Plane<f32>],
    /// u to start from, one plane per frame: [`uncertainty_of_static`] of the confidence that a
    /// pixel is static.
    pub uncertainty: &'a [Plane<f32>],
}

/// u to start from at a pixel that is static with confidence `m` in 0..1:
/// `clamp(min(m, 0.5), 1e-3, 1)` (MegaSaM). What is not a number counts as moving.
#[must_use]
pub fn uncertainty_of_static(m: f32) -> f32 {
    if m > 1e-3 { m.min(0.5) } else { 1e-3 }
}

/// Why pairs could not be stored or read back.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PairError {
    /// A pair of a frame with itself, one that was there already, or planes of another size; the
    /// text says which.
    #[error("{0}")]
    Input(String),
    /// The temporary file of pairs that do not fit into memory.
    #[error(
        "the temporary file of flow fields cannot be used ({0}); free space in the temporary folder or allow more memory"
    )]
    Spill(#[from] std::io::Error),
}

/// Why no consistent depth could be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CvdError {
    /// Inputs that do not belong together, are too small or hold numbers that cannot be worked
    /// with; the text says which.
    #[error("{0}")]
    Input(String),
    /// No pixel of any pair is usable.
    #[error(
        "no pixel of the {pairs} pairs has a consistent flow; there is nothing to make the depth consistent with"
    )]
    NoFlow {
        /// Pairs given.
        pairs: usize,
    },
    /// Pairs could not be read.
    #[error(transparent)]
    Pairs(#[from] PairError),
    /// The user asked to stop.
    #[error("stopped on request in stage {stage} after {step} steps")]
    Cancelled {
        /// 1 or 2.
        stage: usize,
        /// Steps of that stage that were finished.
        step: usize,
    },
}
