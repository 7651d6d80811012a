//! What differs between trainings, each with its source; constants stand beside the code that uses them.

mod density;
mod rates;

pub use density::{CloneOpacity, DensityConfig, ErrorRange, PruneRule, SplitPlacement, SplitSize};
pub use m4_kernels::adam::cpu::AdamConfig;
pub use rates::{RateConfig, RefineConfig};

use crate::TrainError;

/// Settings of a [`crate::Trainer`]. Defaults are those of [`TrainConfig::fast`].
#[derive(Debug, Clone, PartialEq)]
pub struct TrainConfig {
    /// Steps of [`batch`](Self::batch) frames each. Paper: 5000 (DyCheck, DAVIS), 1500 (NVIDIA).
    pub iterations: usize,
    /// Frames per step; their gradients are added up before splats move, and rates are multiplied by the root of their
    /// number: with more frames a step is surer, and there are fewer of them (the square-root rule for Adam, Malladi et
    /// al. 2022). Reference: 1.
    pub batch: usize,
    /// Key of every random draw.
    pub seed: u64,
    /// Rounds of the least-squares fit of colours after the last step; 0 for no fit. 1: more of them fit what is half
    /// hidden too closely (`docs/decisions/0005`). A frame of a round costs about as much as a step, in the first round
    /// half as much again.
    pub colour_fit_rounds: usize,
    /// Weight of `1 - SSIM` beside L1. 0.2 (3DGS, Instant4D; the paper gives no value); 0.4 here (measured: +0.003
    /// SSIM on held-out views at no loss of PSNR).
    pub lambda_ssim: f32,
    /// In a clip with one centre of projection: weight of the growth of dynamic splats, [`m4_kernels::cover`], as the least
    /// difference in colour, 0..1, that is assumed between them and what is behind. 0 for none. 0.01 (measured: docs/geometry.md,
    /// "Layers without parallax").
    pub cover: f32,
    /// How fast parameters move.
    pub lr: RateConfig,
    /// The optimiser (docs/spec/optimiser.md 3). The bias of the moments is corrected by each splat's own number of steps, 0 for new ones.
    pub adam: AdamConfig,
    /// Adding and removing splats.
    pub density: DensityConfig,
    /// Half way through the run, splats of rotating surfaces become three segments of arcs (docs/spec/optimiser.md 8.8, our rule).
    pub arcs: bool,
    /// Poses, focal length and exposure.
    pub refine: RefineConfig,
    /// Opacity-compensated 2D filter (docs/spec/optimiser.md 1.6); false in the reference.
    pub mip: bool,
    /// Colour behind everything. `None`: the mean colour of pixels without a surface (depth 0) where at
    /// least one in a thousand has none, else black (reference: black).
    pub background: Option<[f32; 3]>,
    /// Splats are laid out anew along a Morton curve every so many iterations, and whenever their
    /// number changes. 0 for the latter only.
    pub reorder_every: usize,
    /// Iterations between two checks that every parameter is finite; the state of the last check is
    /// kept in case one is not.
    pub guard_every: usize,
    /// On a GPU: seconds between two copies of its splats that are kept, at checks; 0 for one at every check. 2: of a run
    /// that fails no more than that is lost, and splats are rarely copied.
    pub keep_every_s: f32,
    /// Iterations between two [`crate::MetricsEvent`]s.
    pub metrics_every: usize,
    /// Memory for frames prepared for the loss, MB; frames beyond it are prepared anew at each use, which
    /// costs a millisecond of one core at 480x360. 160: with 100 frames of that size and 100,000 splats training
    /// stays below 500 MB.
    pub target_cache_mb: usize,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self::fast()
    }
}

impl TrainConfig {
    /// Our choices (docs/spec/optimiser.md 9, D1): static splats without time, velocities, budgeted density control, colours by
    /// least squares at the end.
    #[must_use]
    pub fn fast() -> Self {
        Self {
            iterations: 2000,
            batch: 1,
            seed: 0,
            colour_fit_rounds: 1,
            lambda_ssim: 0.4,
            cover: 0.01,
            lr: RateConfig::default(),
            adam: AdamConfig::default(),
            density: DensityConfig::fast(),
            arcs: true,
            refine: RefineConfig::default(),
            mip: true,
            background: None,
            reorder_every: 0,
            guard_every: 100,
            keep_every_s: 2.0,
            metrics_every: 50,
            target_cache_mb: 160,
        }
    }

    /// The paper's letter, read as Instant4D (docs/spec/optimiser.md 3): photometric loss alone, frozen velocities,
    /// dense Adam, full size, literal scores.
    #[must_use]
    pub fn faithful() -> Self {
        Self {
            iterations: 5000,
            colour_fit_rounds: 0,
            lambda_ssim: 0.2,
            cover: 0.0,
            lr: RateConfig::faithful(),
            adam: AdamConfig { sparse: false, beta2_dynamic: 0.999, ..AdamConfig::default() },
            density: DensityConfig::faithful(),
            arcs: false,
            mip: false,
            background: Some([0.0; 3]),
            ..Self::fast()
        }
    }

    /// Refuses values that no run can use.
    ///
    /// # Errors
    ///
    /// [`TrainError::BadSetting`] naming the first field out of range.
    pub fn check(&self) -> Result<(), TrainError> {
        let (density, lr, refine) = (&self.density, &self.lr, &self.refine);
        let shares = [
            ("loss.lambda_ssim", self.lambda_ssim),
            ("cover", self.cover),
            ("density.until", density.until),
            ("density.error_threshold", density.error_threshold),
            ("density.budget", density.budget),
            ("density.final_opacity", density.final_opacity),
        ];
        for (field, value) in shares {
            if !(0.0..=1.0).contains(&value) {
                return Err(bad(field, value, "between 0 and 1"));
            }
        }
        let not_negative = [
            ("lr.position", lr.position),
            ("lr.position_end", lr.position_end),
            ("lr.colour", lr.colour),
            ("lr.opacity", lr.opacity),
            ("lr.scale", lr.scale),
            ("lr.rotation", lr.rotation),
            ("lr.time_sd", lr.time_sd),
            ("lr.velocity", lr.velocity),
            ("refine.rotation_lr", refine.rotation_lr),
            ("refine.translation_lr", refine.translation_lr),
            ("refine.exposure_lr", refine.exposure_lr),
            ("keep_every_s", self.keep_every_s),
        ];
        for (field, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(bad(field, value, "a number of at least 0"));
            }
        }
        if !(density.max_growth.is_finite() && density.max_growth > 0.0) {
            return Err(bad("density.max_growth", density.max_growth, "a number above 0"));
        }
        let counts = [
            ("guard_every", self.guard_every),
            ("metrics_every", self.metrics_every),
            ("density.every", density.every),
            ("density.prune_every", density.prune_every),
            ("density.frames", density.frames),
            ("iterations", self.iterations),
            ("batch", self.batch),
        ];
        for (field, value) in counts {
            if value == 0 {
                return Err(bad(field, value, "at least 1"));
            }
        }
        Ok(())
    }
}

fn bad(field: &'static str, value: impl ToString, expected: &'static str) -> TrainError {
    TrainError::BadSetting { field, value: value.to_string(), expected }
}

#[cfg(test)]
mod tests {
    use super::TrainConfig;

    #[test]
    fn the_profiles_are_valid_and_bad_values_are_named() {
        TrainConfig::fast().check().unwrap();
        TrainConfig::faithful().check().unwrap();
        let mut broken = TrainConfig::fast();
        broken.lr.opacity = f32::NAN;
        assert!(broken.check().unwrap_err().to_string().contains("`lr.opacity` is NaN"));
        let mut broken = TrainConfig::fast();
        broken.density.every = 0;
        assert!(broken.check().is_err());
    }
}
