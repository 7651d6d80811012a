//! Settings of loss-guided density control (section 3.3 of the paper, equations 6 to 10; docs/spec/optimiser.md 4).

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
    /// Every splat above the threshold; scores min-max normalised over all splats (paper eq. 10, to the letter).
    Literal,
    /// Those above the threshold whose opacity is also low; scores normalised over the splats that have one,
    /// clipped at a quantile (docs/spec/optimiser.md 4.4).
    WithOpacity {
        /// A splat above the threshold goes only when its opacity is below this. docs/spec/optimiser.md 4.4: 0.1; 0.005 here, which
        /// leaves moving shadows alone.
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
    /// Drawn from the splat's Gaussian, for dynamic splats in space and time, scales over 1.6, opacity kept (3DGS,
    /// 4DGS; docs/spec/optimiser.md 4.4).
    Sample,
    /// 0.6 standard deviations to both sides along the longest axis, 0.8 of its length: two Gaussians of
    /// the parent's mean and covariance (docs/spec/optimiser.md 4.4, alternative), which share the parent's opacity as
    /// clones do. The image hardly changes, where a random draw costs decibels for hundreds of steps.
    LongestAxis,
}

/// The opacity of a clone and its parent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CloneOpacity {
    /// Both keep it (3DGS).
    Keep,
    /// `1 - sqrt(1 - o)` each: together they let as much light pass as one did (3DGS-MCMC).
    Share,
}

/// Loss-guided density control. Defaults are those of [`DensityConfig::fast`].
#[derive(Debug, Clone, PartialEq)]
pub struct DensityConfig {
    /// Off: the number of splats stays as initialised.
    pub enabled: bool,
    /// Errors of frames decide. Off: gradients, as in 3DGS, for comparison. See [`Self::by_gradient`].
    pub loss_guided: bool,
    /// Frames scored at each round. Paper: K = 10.
    pub frames: usize,
    /// Normalised error above which a pixel counts, 0..1. Paper: 0.1.
    pub error_threshold: f32,
    /// How errors are normalised.
    pub error_range: ErrorRange,
    /// Score above which a splat is cloned or split (raw sums of error, mean over the frames). Paper: tau_den = 0.001.
    pub densify_threshold: f32,
    /// Normalised score above which a splat is pruned. Paper: tau_pru = 0.009.
    pub prune_threshold: f32,
    /// Which splats the prune score removes.
    pub prune_rule: PruneRule,
    /// First iteration of density control. 500 (3DGS, Instant4D).
    pub from: usize,
    /// Share of all iterations after which it ends. docs/spec/optimiser.md 4.4: 0.6; reference: 1.
    pub until: f32,
    /// Iterations between two rounds of densification. 100 (3DGS).
    pub every: usize,
    /// Iterations between two rounds of score pruning. docs/spec/optimiser.md 4.4: 500; literal: 100.
    pub prune_every: usize,
    /// At most this share of all splats is cloned or split in a round, those of the highest scores
    /// (docs/spec/optimiser.md 4.4: 0.05); 1 for no limit. 0.02 here: the start is dense already.
    pub budget: f32,
    /// At most this multiple of the first number of splats (docs/spec/optimiser.md 4.4: 1.5). 1.02 here: the start is dense already,
    /// and the splats of the highest scores are large: a tenth more of all splats doubles the time of a step, for the
    /// quality that the time lost costs (`docs/decisions/0005`).
    pub max_growth: f32,
    /// Clone or split.
    pub split_size: SplitSize,
    /// Where children lie.
    pub split_placement: SplitPlacement,
    /// Opacity of clones.
    pub clone_opacity: CloneOpacity,
    /// Splats below this opacity are removed at every round. 0.005 (3DGS); 0.003 here, for moving shadows.
    pub min_opacity: f32,
    /// Splats below this opacity are removed at the end. docs/spec/optimiser.md 4.4: 0.02; 0 for none. 0.005 here: a moving shadow is
    /// made of splats of opacity 0.01 to 0.1 (measured: 0.4 dB on whole held-out views).
    pub final_opacity: f32,
}

impl Default for DensityConfig {
    fn default() -> Self {
        Self::fast()
    }
}

impl DensityConfig {
    /// Whether a backend must collect gradients in the image.
    pub(crate) fn needs_image_gradients(&self) -> bool {
        self.enabled && !self.loss_guided
    }

    /// The recommended reading of docs/spec/optimiser.md 4.4.
    pub fn fast() -> Self {
        Self {
            enabled: true,
            loss_guided: true,
            frames: 10,
            error_threshold: 0.1,
            error_range: ErrorRange::Quantile { high: 0.995 },
            densify_threshold: 0.001,
            prune_threshold: 0.009,
            prune_rule: PruneRule::WithOpacity { opacity: 0.005, quantile: 0.999 },
            from: 500,
            until: 0.6,
            every: 100,
            prune_every: 500,
            budget: 0.02,
            max_growth: 1.02,
            split_size: SplitSize::Pixels { pixels: 2.0 },
            split_placement: SplitPlacement::LongestAxis,
            clone_opacity: CloneOpacity::Share,
            min_opacity: 0.003,
            final_opacity: 0.005,
        }
    }

    /// Densification by gradients with the constants of 3DGS: from step 500, every 100, threshold 0.0002, split above 0.01 of the extent,
    /// opacity at least 0.005. It goes on to the end, as in Instant4D: 3DGS ends after 15,000 steps. The cap is that of
    /// [`Self::faithful`].
    pub fn by_gradient() -> Self {
        Self { loss_guided: false, densify_threshold: 0.0002, ..Self::faithful() }
    }

    /// Equations 6 to 10 to the letter where they can be read, else as the code they derive from:
    /// p(t) with peak 1, footprints of composited pixels, raw sums, both rounds every 100 iterations to
    /// the end. The cap on the number of splats is a guard for memory and ours.
    pub fn faithful() -> Self {
        Self {
            error_range: ErrorRange::MinMax,
            prune_rule: PruneRule::Literal,
            until: 1.0,
            prune_every: 100,
            budget: 1.0,
            max_growth: 3.0,
            split_size: SplitSize::Extent { share: 0.01 },
            split_placement: SplitPlacement::Sample,
            clone_opacity: CloneOpacity::Keep,
            min_opacity: 0.005,
            final_opacity: 0.0,
            ..Self::fast()
        }
    }
}
