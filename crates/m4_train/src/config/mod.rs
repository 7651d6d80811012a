//! What differs between trainings, each with its source; constants stand beside the code that uses
//! them.

use crate::{ColourDegree, TrainError};
pub use density::{CloneOpacity, DensityConfig, ErrorRange, PruneRule, SplitPlacement, SplitSize};
pub(crate) use density::{LARGE_EXTENT, LARGE_FROM, LARGE_PX};
pub use m4_kernels::adam::cpu::AdamConfig;

mod density;

/// Settings of a [`crate::Trainer`]. Defaults are those of [`TrainConfig::fast`].
#[derive(Debug, Clone, PartialEq)]
pub struct TrainConfig {
    /// Steps of [`batch`](Self::batch) frames each. Paper: 5000 (DyCheck, DAVIS), 1500 (NVIDIA).
    pub iterations: usize,
    /// Frames per step; their gradients are added up before splats move, and rates are multiplied
    /// by the root of their number: with more frames a step is surer, and there are fewer of them
    /// (the square-root rule for Adam, Malladi et al. 2022). Reference: 1.
    pub batch: usize,
    /// Key of every random draw.
    pub seed: u64,
    /// Highest degrees of the harmonics of colours, which rise during the run.
    pub colour_degree: ColourDegree,
    /// Rounds of the least-squares fit of colours after the last step; 0 for no fit. 1: more of
    /// them fit what is half hidden too closely (`docs/decisions/0005`). A frame of a round costs
    /// about as much as a step, in the first round half as much again.
    pub colour_fit_rounds: usize,
    /// Weight of `1 - SSIM` beside L1. 0.2 (3DGS, Instant4D; the paper gives no value); 0.4 here
    /// (measured: +0.003 SSIM on held-out views at no loss of PSNR).
    pub lambda_ssim: f32,
    /// In a clip with one centre of projection: weight of the growth of dynamic splats,
    /// [`m4_kernels::cover`], as the least difference in colour, 0..1, that is assumed between them
    /// and what is behind. 0 for none. 0.015 (measured: docs/geometry-log.md, "Layers
    /// without parallax").
    pub cover: f32,
    /// How fast parameters move.
    pub lr: RateConfig,
    /// The optimiser (docs/spec/optimiser.md 3). The bias of the moments is corrected by each
    /// splat's own number of steps, 0 for new ones.
    pub adam: AdamConfig,
    /// Adding and removing splats.
    pub density: DensityConfig,
    /// Poses, focal length and exposure.
    pub refine: RefineConfig,
    /// Opacity-compensated 2D filter (docs/spec/optimiser.md 1.6); false in the reference.
    pub mip: bool,
    /// Colour behind everything. `None`: the mean colour of pixels without a surface (depth 0)
    /// where at least one in a thousand has none, else black (reference: black).
    pub background: Option<[f32; 3]>,
    /// Iterations between two checks that every parameter is finite; the state of the last check is
    /// kept in case one is not.
    pub guard_every: usize,
    /// On a GPU: seconds between two copies of its splats that are kept, at checks; 0 for one at
    /// every check. 2: of a run that fails no more than that is lost, and splats are rarely copied.
    pub keep_every_s: f32,
    /// Iterations between two [`crate::MetricsEvent`]s.
    pub metrics_every: usize,
    /// Memory for frames prepared for the loss, MB; frames beyond it are prepared anew at each use,
    /// which costs a millisecond of one core at 480x360. 160: with 100 frames of that size and
    /// 100,000 splats training stays below 500 MB.
    pub target_cache_mb: usize,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self::fast()
    }
}

impl TrainConfig {
    /// Our choices (docs/spec/optimiser.md 9, D1): static splats without time, velocities, dense
    /// first splats, colours by least squares at the end. Density control is off: it costs 6 % of
    /// the time and gains nothing (docs/decisions/0003-density-control.md).
    pub fn fast() -> Self {
        Self {
            iterations: 2000,
            batch: 1,
            seed: 0,
            colour_degree: ColourDegree::default(),
            colour_fit_rounds: 1,
            lambda_ssim: 0.4,
            cover: 0.015,
            lr: RateConfig::default(),
            adam: AdamConfig::default(),
            density: DensityConfig {
                enabled: false,
                ..DensityConfig::fast()
            },
            refine: RefineConfig::default(),
            mip: true,
            background: None,
            guard_every: 100,
            keep_every_s: 2.0,
            metrics_every: 50,
            target_cache_mb: 160,
        }
    }

    /// The paper's letter, read as Instant4D (docs/spec/optimiser.md 3): photometric loss alone,
    /// frozen velocities, dense Adam, full size; density control by rank
    /// ([`DensityConfig::faithful`]).
    pub fn faithful() -> Self {
        Self {
            iterations: 5000,
            colour_fit_rounds: 0,
            lambda_ssim: 0.2,
            cover: 0.0,
            lr: RateConfig::faithful(),
            adam: AdamConfig {
                sparse: false,
                beta2_dynamic: 0.999,
                ..AdamConfig::default()
            },
            density: DensityConfig::faithful(),
            mip: false,
            ..Self::fast()
        }
    }

    /// Refuses values that no run can use. Fails with [`TrainError::BadSetting`] naming the first
    /// field out of range.
    pub fn check(&self) -> Result<(), TrainError> {
        let (density, lr, refine) = (&self.density, &self.lr, &self.refine);
        let shares = [
            ("loss.lambda_ssim", self.lambda_ssim),
            ("cover", self.cover),
            ("density.from", density.from),
            ("density.until", density.until),
            ("density.every", density.every),
            ("density.prune_every", density.prune_every),
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
            ("lr.colour_harmonics", lr.colour_harmonics),
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
            return Err(bad(
                "density.max_growth",
                density.max_growth,
                "a number above 0",
            ));
        }
        let counts = [
            ("guard_every", self.guard_every),
            ("metrics_every", self.metrics_every),
            ("density.frames", density.frames),
            ("iterations", self.iterations),
            ("batch", self.batch),
        ];
        for (field, value) in counts {
            if value == 0 {
                return Err(bad(field, value, "at least 1"));
            }
        }
        let degree = self.colour_degree;
        for (field, value, most) in [
            ("colour_degree.space", degree.space, 3),
            ("colour_degree.time", degree.time, 2),
        ] {
            if value > most {
                return Err(bad(
                    field,
                    value,
                    if most == 3 { "0 to 3" } else { "0 to 2" },
                ));
            }
        }
        if u32::try_from(self.iterations).is_err() {
            return Err(bad(
                "iterations",
                self.iterations,
                "at most 4294967295, which a checkpoint can hold",
            ));
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

/// Learning rates at the start of the run (docs/spec/optimiser.md 3).
#[derive(Debug, Clone, PartialEq)]
pub struct RateConfig {
    /// Of means, in units of [`crate::SceneScale::extent`]. 1.6e-4 (3DGS); 3e-4 here, as for
    /// colours.
    pub position: f32,
    /// Of means at the end; between them rates fall log-linearly. 1.6e-6 (3DGS); 8e-6 here, as for
    /// colours.
    pub position_end: f32,
    /// Of constant colours. 2.5e-3 (3DGS); 0.02 here: a dynamic splat is seen in a few dozen steps
    /// (measured on held-out views: +1 to +2 dB after 500 steps, with the other rates alike; faster
    /// than this costs dynamic parts 0.1 to 0.2 dB in longer runs).
    pub colour: f32,
    /// Of the other colour coefficients. 1.25e-4, a twentieth of that of constant colours (3DGS);
    /// 0.02 here, as constant colours: with a twentieth they hardly move in a thousand steps
    /// (measured on held-out views).
    pub colour_harmonics: f32,
    /// Of opacities (logit). 0.05 (3DGS): faster ones make dynamic objects translucent from every
    /// view but the training camera's (measured on held-out views: -0.15 dB inside the dynamic
    /// parts at 0.3).
    pub opacity: f32,
    /// Of scales (logarithm). 0.005 (3DGS); 0.03 here, as for colours.
    pub scale: f32,
    /// Of quaternions. 0.001 (3DGS); 0.006 here, as for colours.
    pub rotation: f32,
    /// Of the middle of a life: the reference's `position * (frames - 1) / D` frames, with this D;
    /// 0 for a middle that stays. docs/spec/optimiser.md 3 proposes 0.02 frames, but with a
    /// velocity the step moves the splat along its path, faster than `position` allows: 0 here.
    pub time_mean_reference: f32,
    /// Of the logarithm of the standard deviation in time. 0.005, as for scales (reference).
    pub time_sd: f32,
    /// Of velocities, in units of the extent over the first standard deviation in time. 1.6e-4
    /// (docs/spec/optimiser.md 3); it falls as that of positions does.
    pub velocity: f32,
    /// All rates but those of position and velocity are multiplied by this at the end of the run
    /// (log-linearly). 1 in 3DGS; 0.05 here, since they start higher.
    pub other_end: f32,
}

impl Default for RateConfig {
    fn default() -> Self {
        Self {
            position: 3e-4,
            position_end: 8e-6,
            colour: 0.02,
            colour_harmonics: 0.02,
            opacity: 0.05,
            scale: 0.03,
            rotation: 0.006,
            time_mean_reference: 0.0,
            time_sd: 0.005,
            velocity: 1.6e-4,
            other_end: 0.05,
        }
    }
}

impl RateConfig {
    /// Instant4D's rates: no velocity, no rotation, time as the reference
    /// (docs/spec/optimiser.md 3; D7).
    pub fn faithful() -> Self {
        Self {
            position: 1.6e-4,
            position_end: 1.6e-6,
            colour: 2.5e-3,
            colour_harmonics: 1.25e-4,
            opacity: 0.05,
            scale: 0.005,
            rotation: 0.0,
            other_end: 1.0,
            time_mean_reference: 3.0,
            velocity: 0.0,
            ..Self::default()
        }
    }
}

/// Per-frame corrections by their own gradients (docs/spec/optimiser.md 8.4).
#[derive(Debug, Clone, PartialEq)]
pub struct RefineConfig {
    /// Correct the pose of every frame but the first, which fixes the world.
    pub poses: bool,
    /// Correct one factor of all focal lengths.
    pub focal: bool,
    /// Correct the colours of every frame by a 3x4 matrix.
    pub exposure: bool,
    /// First iteration that corrects anything: splats must first look like something.
    pub from: usize,
    /// Radians a step. 5e-5: about a fiftieth of a pixel at a focal length of 400 (our choice).
    pub rotation_lr: f32,
    /// In medians of the depth a step. 5e-5 (our choice).
    pub translation_lr: f32,
    /// Of matrix and offset. 5e-4 (our choice).
    pub exposure_lr: f32,
    /// Pull of the exposure to the identity: added to the gradient, times the difference.
    pub exposure_pull: f32,
}

impl Default for RefineConfig {
    fn default() -> Self {
        Self {
            poses: false,
            focal: false,
            exposure: false,
            from: 200,
            rotation_lr: 5e-5,
            translation_lr: 5e-5,
            exposure_lr: 5e-4,
            exposure_pull: 1e-3,
        }
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
        assert!(
            broken
                .check()
                .unwrap_err()
                .to_string()
                .contains("`lr.opacity` is NaN")
        );
        let mut broken = TrainConfig::fast();
        broken.density.every = -1.0;
        assert!(broken.check().is_err());
        let endless = TrainConfig {
            iterations: 5_000_000_000,
            ..TrainConfig::fast()
        };
        assert!(
            endless
                .check()
                .unwrap_err()
                .to_string()
                .contains("`iterations` is 5000000000")
        );
    }
}
