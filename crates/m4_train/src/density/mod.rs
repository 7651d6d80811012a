//! Loss-guided density control (Minute4D sec. 3.3): adds splats where the image is wrong, and
//! prunes splats that stay wrong.
//!
//! | file | what it does |
//! |---|---|
//! | `score` | error map to masked error; masked errors of K frames to two scores per splat |
//! | `round` | what a round is given, and what it did |
//! | `decide` | the rules of a round; scores to the splats to clone, split and prune; decisions to the rows of the next set |
//! | `new_splats` | the parameters of clones and children |
//! | `gradient` | the statistic of 3DGS in place of the scores, for comparison |
//!
//! Readings where the paper is open (docs/spec/optimiser.md 4.4): p(t) is the marginal with peak 1;
//! a splat's footprint are the pixels that it is composited on; scores are raw sums of error. Both
//! scores are taken from the same state of the splats; new splats are never pruned in the round
//! that made them, nor are parents of clones.

mod decide;
#[cfg(feature = "gpu")]
pub(crate) mod gpu;
mod gradient;
mod new_splats;
mod round;
mod score;

pub use decide::{Decision, Origin, Plan, Rules, SplatView, decide};
pub(crate) use gradient::GradientSums;
pub use new_splats::apply;
pub(crate) use new_splats::rearrange;
pub use round::{DensityRound, DensityStats, ScoreSettings};
pub use score::masked_error;
pub(crate) use score::{ScoreInput, score};

/// The two scores of every splat.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scores {
    /// `[n]` mean over the frames of the time-weighted masked error on the footprint.
    pub densify: Vec<f32>,
    /// `[n]` the same weighted by the frame's photometric loss, summed, not yet normalised.
    pub prune: Vec<f32>,
}
