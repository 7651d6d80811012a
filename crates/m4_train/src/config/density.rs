//! Settings of loss-guided density control (section 3.3 of the paper, equations 6 to 10;
//! docs/spec/optimiser.md 4).

/// How an error map is brought to 0..1 before it is compared with the threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ErrorRange {
    /// Smallest to largest error of the frame (paper eq. 7).
    MinMax,
    /// 0 to this quantile: one hot pixel does not hide all others (docs/spec/optimiser.md 4.4).
    Quantile {
        /// 0..1.
        high: f32,
    },
}

/// Which splats the prune score removes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PruneRule {
    /// Every splat above the threshold; scores min-max normalised over all splats (paper eq. 10, to
    /// the letter).
    Literal,
    /// Those above the threshold whose opacity is also low; scores normalised over the splats that
    /// have one, clipped at a quantile (docs/spec/optimiser.md 4.4).
    WithOpacity {
        /// A splat above the threshold goes only when its opacity is below this.
        /// docs/spec/optimiser.md 4.4: 0.1; 0.005 here, which leaves moving shadows alone.
        opacity: f32,
        /// Scores above this quantile count as it.
        quantile: f32,
    },
}

/// The size at which a splat is split rather than cloned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SplitSize {
    /// Largest standard deviation above this share of the extent. 0.01 (3DGS).
    Extent {
        /// Share.
        share: f32,
    },
    /// Largest standard deviation above this many pixels as the nearest camera sees it.
    Pixels {
        /// Pixels.
        pixels: f32,
    },
}

/// Where the children of a split lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SplitPlacement {
    /// Drawn from the splat's Gaussian, for dynamic splats in space and time, scales over 1.6,
    /// opacity kept (3DGS, 4DGS; docs/spec/optimiser.md 4.4).
    Sample,
    /// 0.6 standard deviations to both sides along the longest axis, 0.8 of its length: two
    /// Gaussians of the parent's mean and covariance, which share its opacity as clones do and live
    /// as long as it did. The image hardly changes, where a random draw costs decibels for hundreds
    /// of steps, and views from the side keep their surfaces (docs/decisions/0003). A sphere is
    /// halved along a direction that is drawn, and its children have its scale over 1.6 (3DGS),
    /// which suits a surface.
    Halves,
}

/// The opacity of a clone and its parent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CloneOpacity {
    /// Both keep it (3DGS).
    Keep,
    /// `1 - sqrt(1 - o)` each: together they let as much light pass as one did (3DGS-MCMC).
    Share,
}

/// Share of the run from which large splats are pruned: iteration 3,000 of the paper's 5,000 (3DGS,
/// Instant4D).
pub(crate) const LARGE_FROM: f32 = 0.6;
/// Splats whose radius of three standard deviations is above this many pixels in the nearest camera
/// are too large (3DGS, Instant4D).
pub(crate) const LARGE_PX: f32 = 20.0;
/// Splats whose standard deviation is above this share of the extent are too large (3DGS,
/// Instant4D).
pub(crate) const LARGE_EXTENT: f32 = 0.1;

/// Loss-guided density control. Defaults are those of [`DensityConfig::fast`].
#[derive(Debug, Clone, PartialEq)]
pub struct DensityConfig {
    /// Off: the number of splats stays as initialised.
    pub enabled: bool,
    /// Errors of frames decide. Off: gradients, as in 3DGS, for comparison. See
    /// [`Self::by_gradient`].
    pub loss_guided: bool,
    /// Frames scored at each round. Paper: K = 10.
    pub frames: usize,
    /// Normalised error above which a pixel counts, 0..1. Paper: 0.1.
    pub error_threshold: f32,
    /// How errors are normalised.
    pub error_range: ErrorRange,
    /// Score above which a splat is cloned or split (raw sums of error, mean over the frames).
    /// Paper: tau_den = 0.001.
    pub densify_threshold: f32,
    /// Normalised score above which a splat is pruned. Paper: tau_pru = 0.009.
    pub prune_threshold: f32,
    /// Which splats the prune score removes.
    pub prune_rule: PruneRule,
    /// Share of all iterations before the first round. 0.1: iteration 500 of the paper's 5,000
    /// (3DGS, Instant4D).
    pub from: f32,
    /// Share of all iterations after which it ends. docs/spec/optimiser.md 4.4: 0.6; reference: 1.
    pub until: f32,
    /// Share of all iterations between two rounds of densification. 0.02: 100 of 5,000 (3DGS); 0.05
    /// here, since a round costs as much as several steps, of which a minute has few.
    pub every: f32,
    /// Share of all iterations between two rounds of score pruning. 0.1: 500 of 5,000
    /// (docs/spec/optimiser.md 4.4); literal: 0.02.
    pub prune_every: f32,
    /// At most this share of all splats is cloned or split in a round, those of the highest scores
    /// (docs/spec/optimiser.md 4.4: 0.05); 1 for no limit. 0.1 from a sparse start (measured:
    /// docs/decisions/0003); 0.02 here: the start is dense already.
    pub budget: f32,
    /// At most this multiple of the first number of splats (docs/spec/optimiser.md 4.4: 1.5). 1.02
    /// here: the start is dense already, and the splats of the highest scores are large: a tenth
    /// more of all splats doubles the time of a step, for the quality that the time lost costs
    /// (`docs/decisions/0005`).
    pub max_growth: f32,
    /// Clone or split.
    pub split_size: SplitSize,
    /// Where children lie.
    pub split_placement: SplitPlacement,
    /// Opacity of clones.
    pub clone_opacity: CloneOpacity,
    /// Splats below this opacity are removed at every round. 0.005 (3DGS); 0.003 here, for moving
    /// shadows.
    pub min_opacity: f32,
    /// After 0.6 of the run, rounds of densification prune splats of a radius above 20 pixels or a
    /// standard deviation above a tenth of the extent (3DGS, Instant4D).
    pub prune_large: bool,
    /// Splats below this opacity are removed at the end. docs/spec/optimiser.md 4.4: 0.02; 0 for
    /// none. 0.005 here: a moving shadow is made of splats of opacity 0.01 to 0.1 (measured: 0.4 dB
    /// on whole held-out views).
    pub final_opacity: f32,
}

impl Default for DensityConfig {
    fn default() -> Self {
        Self::fast()
    }
}

impl DensityConfig {
    /// Whether a round that comes every such share of the run is due after iteration `i` of `n`.
    pub(crate) fn is_due(&self, every: f32, i: usize, n: usize) -> bool {
        let iterations = |share: f32| (f64::from(share) * n as f64).round() as usize;
        let within = i >= iterations(self.from) && i as f64 <= f64::from(self.until) * n as f64;
        self.enabled && within && i.is_multiple_of(iterations(every).max(1))
    }

    /// Whether a backend must collect gradients in the image.
    pub(crate) fn needs_image_gradients(&self) -> bool {
        self.enabled && !self.loss_guided
    }

    /// The recommended reading of docs/spec/optimiser.md 4.4 for first splats that are dense
    /// already. The profile `fast` has it off.
    pub fn fast() -> Self {
        Self {
            enabled: true,
            loss_guided: true,
            frames: 10,
            error_threshold: 0.1,
            error_range: ErrorRange::Quantile { high: 0.995 },
            densify_threshold: 0.001,
            prune_threshold: 0.009,
            prune_rule: PruneRule::WithOpacity {
                opacity: 0.005,
                quantile: 0.999,
            },
            from: 0.1,
            until: 0.6,
            every: 0.05,
            prune_every: 0.1,
            budget: 0.02,
            max_growth: 1.02,
            split_size: SplitSize::Pixels { pixels: 2.0 },
            split_placement: SplitPlacement::Halves,
            clone_opacity: CloneOpacity::Share,
            min_opacity: 0.003,
            prune_large: false,
            final_opacity: 0.005,
        }
    }

    /// The paper's schedule and constants with a rank in place of its threshold, which takes half
    /// of all splats at once, and pruning by score only where a splat is nearly transparent
    /// (docs/decisions/0003-density-control.md): in a round the tenth of the splats that has the
    /// highest scores, until 0.6 of the run, at most half as many again as at first.
    pub fn faithful() -> Self {
        Self {
            error_range: ErrorRange::Quantile { high: 0.995 },
            prune_rule: PruneRule::WithOpacity {
                opacity: 0.1,
                quantile: 0.999,
            },
            until: 0.6,
            prune_every: 0.1,
            budget: 0.1,
            max_growth: 1.5,
            prune_large: false,
            split_placement: SplitPlacement::Halves,
            clone_opacity: CloneOpacity::Share,
            ..Self::literal()
        }
    }

    /// Equations 6 to 10 to the letter where they can be read, else as the code they derive from,
    /// for comparison: p(t) with peak 1, footprints of composited pixels, raw sums, both rounds
    /// every 100 iterations of 5,000 to the end. It destroys the scene
    /// (docs/decisions/0003-density-control.md). The cap on the number of splats is a guard for
    /// memory and ours.
    pub fn literal() -> Self {
        Self {
            error_range: ErrorRange::MinMax,
            prune_rule: PruneRule::Literal,
            until: 1.0,
            every: 0.02,
            prune_every: 0.02,
            budget: 1.0,
            max_growth: 5.0,
            split_size: SplitSize::Extent { share: 0.01 },
            split_placement: SplitPlacement::Sample,
            clone_opacity: CloneOpacity::Keep,
            min_opacity: 0.005,
            prune_large: true,
            final_opacity: 0.0,
            ..Self::fast()
        }
    }

    /// Densification by gradients with the constants of 3DGS, for comparison: from 0.1 of the run,
    /// every 0.02, threshold 0.0002, split above 0.01 of the extent, opacity at least 0.005, large
    /// splats pruned. It goes on to the end, as in Instant4D: 3DGS ends after 15,000 steps. The cap
    /// is that of [`Self::literal`].
    pub fn by_gradient() -> Self {
        Self {
            loss_guided: false,
            densify_threshold: 0.0002,
            ..Self::literal()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::DensityConfig;

    /// Iterations after which a round is due.
    fn rounds(config: &DensityConfig, every: f32, n: usize) -> Vec<usize> {
        (1..=n).filter(|&i| config.is_due(every, i, n)).collect()
    }

    #[test]
    fn rounds_are_those_of_the_paper_in_its_run_and_shares_of_any_other() {
        let config = DensityConfig::literal();
        let paper = rounds(&config, config.every, 5000);
        assert_eq!(
            (paper[0], paper[1], paper[paper.len() - 1]),
            (500, 600, 5000)
        );
        let config = DensityConfig::faithful();
        assert_eq!(
            rounds(&config, config.prune_every, 5000),
            [500, 1000, 1500, 2000, 2500, 3000]
        );
        for n in [100, 370, 870, 1500, 5000] {
            assert!(
                (24..=28).contains(&rounds(&config, config.every, n).len()),
                "{n}"
            );
            let fast = DensityConfig::fast();
            assert!(
                (8..=12).contains(&rounds(&fast, fast.every, n).len()),
                "{n}"
            );
        }
        assert!(
            rounds(
                &DensityConfig {
                    enabled: false,
                    ..config
                },
                0.02,
                1000
            )
            .is_empty()
        );
    }
}
