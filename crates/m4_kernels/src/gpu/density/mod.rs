//! A round of density control on the device (Minute4D sec. 3.3): scores, the choice of splats to clone, split and prune, and the new rows.
//!
//! | file | what it does |
//! |---|---|
//! | `rank` | scores to the best that may grow, and the range that prune scores are measured in |
//! | `fate` | the rows that each splat leaves and bears, and how many there are |
//! | `new_splats` | the next rows, and what clones and halves look like |
//!
//! Rows are laid out by one exclusive sum: static splats that stay, then the new ones, then the same of dynamic splats. All
//! that is read back is how many there are.

mod fate;
mod new_splats;
mod rank;

use crate::View;
use crate::gpu::buffer::Buffer;
use crate::gpu::gather::{gather_state, gathered};
use crate::gpu::trainer::TRAINING;
use crate::gpu::work::Size;
use crate::gpu::{GpuError, ScoreSettings, Trainer};
use cubecl::prelude::Client;

/// The rules of a round.
#[derive(Debug, Clone, Copy)]
pub struct DensityRound<'a> {
    /// Frames by number and how they are seen: their scores choose the splats to change. Unused if no splat is cloned, split or
    /// pruned by score.
    pub looks: &'a [(usize, View)],
    /// Which errors of a frame count.
    pub scores: ScoreSettings,
    /// Which splats are cloned or split; `None` for none.
    pub grow: Option<GrowRule>,
    /// Which splats are pruned by score; `None` for none.
    pub prune: Option<PruneRule>,
    /// Splats of a lower opacity (0..1, without time) go, unless they are split.
    pub min_opacity: f32,
    /// The largest standard deviation above which a splat that grows is split rather than cloned.
    pub split_size: SplitSize<'a>,
    /// Clones and halves share the opacity of their parent, so that they pass the light that it passed; else they keep it.
    pub share_opacity: bool,
}

/// Who may be cloned or split: splats of a score above a threshold, the best of them; ties go to the lower row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GrowRule {
    /// The score that must be exceeded.
    pub threshold: f32,
    /// At most this many.
    pub budget: usize,
}

/// Whom prune scores remove. Scores are measured in the range given, 0..=1, and cut there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PruneRule {
    /// Everybody above the threshold, from the smallest to the largest score; a splat that is cloned too leaves its clone.
    Literal {
        /// 0..=1.
        threshold: f32,
    },
    /// Everybody who does not grow and is above the threshold with a low opacity; from the smallest score above 0 to a
    /// quantile of those above 0.
    WithOpacity {
        /// 0..=1.
        threshold: f32,
        /// The opacity that is not low, 0..=1.
        opacity: f32,
        /// 0..=1.
        quantile: f32,
    },
}

/// The largest standard deviation above which a splat is split rather than cloned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SplitSize<'a> {
    /// The same everywhere, scene units.
    Everywhere(f32),
    /// As large as this many pixels in the nearest camera.
    Pixels {
        /// Pixels.
        pixels: f32,
        /// Focal length, pixels.
        focal_px: f32,
        /// Where cameras are, scene units.
        centres: &'a [[f32; 3]],
    },
}

/// What a round did; nothing where all of the first three are 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DensifyStats {
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

impl Trainer {
    /// Clones, splits and prunes splats by the rules of `round`. Survivors keep the optimiser's state, new splats start from
    /// nothing. Rows are in their old order, static before dynamic, the new ones after those that stay; halves lie 0.6
    /// standard deviations to both sides along the longest axis, 0.8 as long there. Where nothing would be left, nothing
    /// changes.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if there is no such frame, if there is no room, or if the device failed; the trainer is not to be used
    /// after that.
    pub fn densify(&mut self, round: &DensityRound<'_>) -> Result<DensifyStats, GpuError> {
        let n = self.splats.n;
        let unchanged = DensifyStats {
            n_static: self.splats.n_static,
            n_dynamic: n - self.splats.n_static,
            ..DensifyStats::default()
        };
        if n == 0 {
            return Ok(unchanged);
        }
        let client = self.gpu.client.clone();
        let fates = self.fates(&client, round)?;
        let (grown, next) = fates.read(&client, TRAINING)?;
        let nothing_changes = grown.cloned + grown.split + grown.pruned == 0;
        if nothing_changes || next == 0 {
            return Ok(unchanged);
        }
        let rows = new_splats::Rows::new(&client, &fates, (n, unchanged.n_static), next);
        let shape = (next, grown.n_static);
        gather_state(self, &rows.states, shape);
        let splats = gathered(&self.gpu, &self.splats, &rows.sources, shape);
        rows.shape(&client, &self.splats, &splats, round.share_opacity);
        self.splats = splats;
        self.gradients = self.splats.like(&self.gpu);
        self.make(Size {
            n: next,
            ..self.work.size
        })?;
        Ok(grown)
    }

    fn fates(&mut self, client: &Client, round: &DensityRound<'_>) -> Result<fate::Outcomes, GpuError> {
        let scores = self.scores_of_round(round)?;
        let rank = rank::Rank::new(client, self.splats.n);
        let grows = rank.best(client, round.grow, &scores);
        let range = rank.prune_range(client, round.prune, &scores);
        Ok(fate::Outcomes::new(
            client,
            &self.splats,
            round,
            &grows,
            &scores,
            &range,
        ))
    }

    /// Scores `[2][n]` that choose the splats to densify and to prune; unspecified where neither happens.
    fn scores_of_round(&mut self, round: &DensityRound<'_>) -> Result<Buffer, GpuError> {
        if round.grow.is_none() && round.prune.is_none() {
            return Ok(Buffer::empty(&self.gpu.client, 2 * self.splats.n));
        }
        self.scores(round.looks, &round.scores)
    }
}
