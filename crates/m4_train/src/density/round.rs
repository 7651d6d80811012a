//! A round of density control: what it is given, and what it did.

use super::Rules;
use crate::config::ErrorRange;
use m4_kernels::View;

/// Which errors of a frame count, and for how much.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoreSettings {
    /// Share of SSIM in the loss that weights a frame for pruning, 0..=1.
    pub lambda_ssim: f32,
    /// As [`crate::DensityConfig::error_threshold`].
    pub threshold: f32,
    /// As [`crate::DensityConfig::error_range`].
    pub range: ErrorRange,
}

/// A round of density control.
#[derive(Debug, Clone, Copy)]
pub struct DensityRound<'a> {
    /// Frames for the scores, by number; none where nothing is due that needs scores.
    pub views: &'a [(usize, View)],
    /// How errors count.
    pub scores: ScoreSettings,
    /// The plan follows from these: [`Rules::plan`] says how.
    pub rules: Rules<'a>,
    /// Period of the first harmonic of time, frames.
    pub period: f32,
    /// Random positions of halves follow from this
    pub seed: u64,
    /// and from the steps taken.
    pub iteration: usize,
}

/// What a round of density control did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DensityStats {
    /// Splats that were cloned.
    pub cloned: usize,
    /// Splats that were split in two.
    pub split: usize,
    /// Splats that were pruned.
    pub pruned: usize,
    /// Static splats now.
    pub n_static: usize,
    /// Dynamic splats now.
    pub n_dynamic: usize,
}

impl DensityStats {
    /// True when the splats are what they were.
    pub fn changes_nothing(&self) -> bool {
        self.cloned + self.split + self.pruned == 0
    }
}
