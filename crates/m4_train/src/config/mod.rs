//! Settings of the training, each with its source.

mod colour;
mod density;
mod rates;

pub use colour::ColourFitConfig;
pub use density::{DensityConfig, ErrorRange, NewbornOpacity, PruneRule, SplitPlacement, SplitSize};
pub use rates::{AdamSettings, PositionUnit, RateConfig, RefineConfig};

use crate::TrainError;
use serde::{Deserialize, Serialize};

/// What is minimised.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossConfig {
    /// Weight of `1 - SSIM` beside L1. 0.2 (3DGS, Instant4D; the paper gives no value); 0.4 here (measured: +0.003
    /// SSIM on held-out views at no loss of PSNR).
    pub lambda_ssim: f32,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self { lambda_ssim: 0.4 }
    }
}

/// Settings of a [`crate::Trainer`]. Defaults are those of [`TrainConfig::fast`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Steps of [`batch`](Self::batch) frames each. Paper: 5000 (DyCheck, DAVIS), 1500 (NVIDIA).
    pub iterations: usize,
    /// Frames a step; their gradients are added up before splats move. Reference: 1.
    pub batch: usize,
    /// Rates are multiplied by `batch` to this power: with more frames a step is surer, and there are fewer of them. 0.5
    /// (the square-root rule for Adam, Malladi et al. 2022).
    pub batch_rate_power: f32,
    /// Seconds that the optimisation may take, 0 for as many as `iterations` need. Where it is above 0, `iterations` is
    /// replaced by what [`crate::affordable_iterations`] finds before training starts; [`crate::Trainer`] itself
    /// knows iterations alone.
    pub budget_s: f64,
    /// Key of every random draw.
    pub seed: u64,
    /// Colours by least squares.
    pub colour_fit: ColourFitConfig,
    /// What is minimised.
    pub loss: LossConfig,
    /// How fast parameters move.
    pub lr: RateConfig,
    /// The optimiser.
    pub adam: AdamSettings,
    /// Adding and removing splats.
    pub density: DensityConfig,
    /// Poses, focal length and exposure.
    pub refine: RefineConfig,
    /// Opacity-compensated 2D filter (section 1.6); false in the reference.
    pub mip: bool,
    /// Splats nearer than this share of the median depth are not drawn. The reference has 0.2 scene
    /// units whatever the scale (section 1.6).
    pub near_share: f32,
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
    /// Our choices (section 9, D1): static splats without time, velocities, budgeted density control, colours by
    /// least squares at the end.
    #[must_use]
    pub fn fast() -> Self {
        Self {
            iterations: 2000,
            batch: 1,
            batch_rate_power: 0.5,
            budget_s: 0.0,
            seed: 0,
            colour_fit: ColourFitConfig::default(),
            loss: LossConfig::default(),
            lr: RateConfig::default(),
            adam: AdamSettings::default(),
            density: DensityConfig::fast(),
            refine: RefineConfig::default(),
            mip: true,
            near_share: 0.05,
            background: None,
            reorder_every: 0,
            guard_every: 100,
            keep_every_s: 2.0,
            metrics_every: 50,
            target_cache_mb: 160,
        }
    }

    /// The paper's letter, read as Instant4D (section 3): photometric loss alone, frozen velocities,
    /// dense Adam, full size, literal scores.
    #[must_use]
    pub fn faithful() -> Self {
        Self {
            iterations: 5000,
            loss: LossConfig { lambda_ssim: 0.2 },
            lr: RateConfig::faithful(),
            adam: AdamSettings {
                sparse: false,
                beta2_dynamic: 0.999,
                ..AdamSettings::default()
            },
            density: DensityConfig::faithful(),
            colour_fit: ColourFitConfig::off(),
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
        let shares = [
            ("loss.lambda_ssim", self.loss.lambda_ssim),
            ("near_share", self.near_share),
            ("density.until", self.density.until),
            ("density.error_threshold", self.density.error_threshold),
            ("density.budget", self.density.budget),
            ("density.final_opacity", self.density.final_opacity),
        ];
        for (field, value) in shares {
            if !(0.0..=1.0).contains(&value) {
                return Err(bad(field, value, "between 0 and 1"));
            }
        }
        if !(self.budget_s.is_finite() && self.budget_s >= 0.0) {
            return Err(bad("budget_s", self.budget_s, "a number of at least 0"));
        }
        let not_negative = [
            ("batch_rate_power", self.batch_rate_power),
            ("colour_fit.damping_px", self.colour_fit.damping_px),
            ("colour_fit.relax", self.colour_fit.relax),
            ("lr.position", self.lr.position),
            ("lr.position_end", self.lr.position_end),
            ("lr.colour", self.lr.colour),
            ("lr.colour_rest", self.lr.colour_rest),
            ("lr.opacity", self.lr.opacity),
            ("lr.scale", self.lr.scale),
            ("lr.rotation", self.lr.rotation),
            ("lr.time_mean", self.lr.time_mean),
            ("lr.time_sd", self.lr.time_sd),
            ("lr.velocity", self.lr.velocity),
            ("refine.rotation_lr", self.refine.rotation_lr),
            ("refine.translation_lr", self.refine.translation_lr),
            ("refine.focal_lr", self.refine.focal_lr),
            ("refine.exposure_lr", self.refine.exposure_lr),
            ("keep_every_s", self.keep_every_s),
        ];
        for (field, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(bad(field, value, "a number of at least 0"));
            }
        }
        let positive = [
            ("density.split_factor", self.density.split_factor),
            ("density.max_growth", self.density.max_growth),
        ];
        for (field, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(bad(field, value, "a number above 0"));
            }
        }
        let counts = [
            ("guard_every", self.guard_every),
            ("metrics_every", self.metrics_every),
            ("density.every", self.density.every),
            ("density.prune_every", self.density.prune_every),
            ("density.frames", self.density.frames),
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
    TrainError::BadSetting {
        field,
        value: value.to_string(),
        expected,
    }
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
