//! Settings of the first splats and of training.

use super::Profile;
use m4_train::init::{InitConfig, TimeSpread, VelocityInit};
use m4_train::{ColourDegree, DensityConfig, RefineConfig, TrainConfig};
use serde::{Deserialize, Serialize};

/// What users change of the training; the rest is the profile's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainSettings {
    /// As [`TrainConfig::iterations`].
    pub iterations: usize,
    /// As [`TrainConfig::batch`].
    pub batch: usize,
    /// Seconds that training may take, 0 for as many as `iterations` need: the first splats, then
    /// iterations, for at least half of it. Where it is above 0, `iterations` is replaced by what
    /// [`m4_train::affordable_iterations`] finds.
    pub budget_s: f64,
    /// Key of every random draw, those of geometry included ([`super::Settings::set_seed`]).
    pub seed: u64,
    /// As [`TrainConfig::background`].
    pub background: Option<[f32; 3]>,
    /// As [`TrainConfig::metrics_every`].
    pub metrics_every: usize,
    /// As [`TrainConfig::target_cache_mb`].
    pub target_cache_mb: usize,
    /// Harmonics of colours.
    pub colour_degree: ColourDegree,
    /// Colours by least squares.
    pub colour_fit: ColourFitSettings,
    /// What is minimised.
    pub loss: LossSettings,
    /// Adding and removing splats.
    pub density: DensitySettings,
    /// Poses, focal length and exposure.
    pub refine: RefinementSettings,
}

/// Colours by least squares after the last step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColourFitSettings {
    /// As [`TrainConfig::colour_fit_rounds`].
    pub rounds: usize,
}

/// What is minimised.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LossSettings {
    /// As [`TrainConfig::lambda_ssim`].
    pub lambda_ssim: f32,
}

/// What decides which splats are cloned, split and pruned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DensityRule {
    /// The errors of frames, as the profile reads the paper
    /// (`docs/decisions/0003-density-control.md`).
    LossGuided,
    /// The errors of frames, by the paper's letter ([`DensityConfig::literal`]), which ends in
    /// fewer and worse splats; for comparison.
    Literal,
    /// Gradients in the image, as in 3DGS ([`DensityConfig::by_gradient`]); for comparison.
    Gradient,
}

/// Density control; fields are those of [`DensityConfig`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DensitySettings {
    /// Off: the number of splats stays as initialised.
    pub enabled: bool,
    /// What decides.
    pub rule: DensityRule,
    /// Frames scored at each round.
    pub frames: usize,
    /// Normalised error above which a pixel counts, 0..1.
    pub error_threshold: f32,
    /// Score above which a splat is cloned or split.
    pub densify_threshold: f32,
    /// Normalised score above which a splat is pruned.
    pub prune_threshold: f32,
    /// Share of the run before the first round, 0..1.
    pub from: f32,
    /// Share of the run between two rounds of densification, 0..1.
    pub every: f32,
    /// Share of the run between two rounds of pruning by score, 0..1.
    pub prune_every: f32,
}

/// What is corrected beside the splats; fields are those of [`RefineConfig`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RefinementSettings {
    /// The pose of every frame but the first.
    pub poses: bool,
    /// One factor of all focal lengths.
    pub focal: bool,
    /// The colours of every frame.
    pub exposure: bool,
}

impl TrainSettings {
    /// Those of a profile.
    #[must_use]
    pub fn of(profile: Profile) -> Self {
        let config = profile.train();
        let (density, refine) = (config.density, config.refine);
        Self {
            iterations: config.iterations,
            batch: config.batch,
            budget_s: 0.0,
            seed: config.seed,
            background: config.background,
            metrics_every: config.metrics_every,
            target_cache_mb: config.target_cache_mb,
            colour_degree: config.colour_degree,
            colour_fit: ColourFitSettings {
                rounds: config.colour_fit_rounds,
            },
            loss: LossSettings {
                lambda_ssim: config.lambda_ssim,
            },
            density: DensitySettings {
                enabled: density.enabled,
                rule: DensityRule::LossGuided,
                frames: density.frames,
                error_threshold: density.error_threshold,
                densify_threshold: density.densify_threshold,
                prune_threshold: density.prune_threshold,
                from: density.from,
                every: density.every,
                prune_every: density.prune_every,
            },
            refine: RefinementSettings {
                poses: refine.poses,
                focal: refine.focal,
                exposure: refine.exposure,
            },
        }
    }

    /// What the trainer is given; it knows iterations alone, and no seconds.
    #[must_use]
    pub fn config(&self, profile: Profile) -> TrainConfig {
        let base = profile.train();
        let (density, refine) = (&self.density, &self.refine);
        TrainConfig {
            iterations: self.iterations,
            batch: self.batch,
            seed: self.seed,
            background: self.background,
            metrics_every: self.metrics_every,
            target_cache_mb: self.target_cache_mb,
            colour_degree: self.colour_degree,
            colour_fit_rounds: self.colour_fit.rounds,
            lambda_ssim: self.loss.lambda_ssim,
            density: density.config(base.density),
            refine: RefineConfig {
                poses: refine.poses,
                focal: refine.focal,
                exposure: refine.exposure,
                ..base.refine
            },
            ..base
        }
    }
}

impl DensitySettings {
    /// What the trainer is given: of the rules for comparison, settings that they do not know stay
    /// as they have them.
    fn config(&self, of_profile: DensityConfig) -> DensityConfig {
        let scored = |base| DensityConfig {
            frames: self.frames,
            error_threshold: self.error_threshold,
            densify_threshold: self.densify_threshold,
            prune_threshold: self.prune_threshold,
            ..base
        };
        let (rule, prune_every) = match self.rule {
            DensityRule::LossGuided => (scored(of_profile), self.prune_every),
            DensityRule::Literal => (scored(DensityConfig::literal()), self.every),
            DensityRule::Gradient => (DensityConfig::by_gradient(), self.every),
        };
        DensityConfig {
            enabled: self.enabled,
            from: self.from,
            every: self.every,
            prune_every,
            ..rule
        }
    }
}

/// What users change of the first splats; the rest is the profile's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InitSettings {
    /// As [`InitConfig::max_static`].
    pub max_static: Option<usize>,
    /// As [`InitConfig::max_dynamic`].
    pub max_dynamic: usize,
    /// As [`InitConfig::voxel_px`].
    pub voxel_px: Option<f32>,
    /// Standard deviation in time of dynamic splats, gaps between keyframes
    /// ([`TimeSpread::KeyframeGaps`]); `None`: that of the reference.
    pub keyframe_gaps: Option<f32>,
    /// Points are added where the tracks of the capture, or the motion of the frames' own points,
    /// place what a frame cannot see, and tracks give first velocities.
    pub tracks: bool,
}

impl InitSettings {
    /// Those of a profile.
    #[must_use]
    pub fn of(profile: Profile) -> Self {
        let config = profile.init();
        Self {
            max_static: config.max_static,
            max_dynamic: config.max_dynamic,
            voxel_px: config.voxel_px,
            keyframe_gaps: match config.time_spread {
                TimeSpread::KeyframeGaps { factor } => Some(factor),
                TimeSpread::Reference { .. } => None,
            },
            tracks: true,
        }
    }

    /// What the stage is given.
    #[must_use]
    pub fn config(&self, profile: Profile) -> InitConfig {
        let (max_static, max_dynamic, voxel_px) =
            (self.max_static, self.max_dynamic, self.voxel_px);
        let mut config = InitConfig {
            max_static,
            max_dynamic,
            voxel_px,
            ..profile.init()
        };
        if let Some(factor) = self.keyframe_gaps {
            config.time_spread = TimeSpread::KeyframeGaps { factor };
        }
        if !self.tracks {
            config.tracked.enabled = false;
            if let VelocityInit::Register { tracks } = &mut config.velocity {
                *tracks = false;
            }
        }
        config
    }
}
