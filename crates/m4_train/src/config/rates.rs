//! Learning rates, and what else is refined.

/// Learning rates at the start of the run (docs/spec/optimiser.md 3).
#[derive(Debug, Clone, PartialEq)]
pub struct RateConfig {
    /// Of means, in units of [`crate::SceneScale::extent`]. 1.6e-4 (3DGS); 3e-4 here, as for colours.
    pub position: f32,
    /// Of means at the end; between them rates fall log-linearly. 1.6e-6 (3DGS); 8e-6
    /// here, as for colours.
    pub position_end: f32,
    /// Of constant colours; that of the other colour coefficients is a twentieth (3DGS). 2.5e-3 (3DGS); 0.02 here: a dynamic
    /// splat is seen in a few dozen steps (measured on held-out views: +1 to +2 dB after 500 steps, with the other rates
    /// alike; faster than this costs moving parts 0.1 to 0.2 dB in longer runs).
    pub colour: f32,
    /// Of opacities (logit). 0.05 (3DGS): faster ones make dynamic objects translucent from every view but
    /// the training camera's (measured on held-out views: -0.15 dB inside the moving parts at 0.3).
    pub opacity: f32,
    /// Of scales (logarithm). 0.005 (3DGS); 0.03 here, as for colours.
    pub scale: f32,
    /// Of quaternions. 0.001 (3DGS); 0.006 here, as for colours.
    pub rotation: f32,
    /// Of the middle of a life: the reference's `position * (frames - 1) / D` frames, with this D; 0 for a middle that stays.
    /// docs/spec/optimiser.md 3 proposes 0.02 frames, but with a velocity the step moves the splat along its path, faster than `position`
    /// allows: 0 here.
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
    /// Instant4D's rates: no velocity, no rotation, time as the reference (docs/spec/optimiser.md 3; D7).
    #[must_use]
    pub fn faithful() -> Self {
        Self {
            position: 1.6e-4,
            position_end: 1.6e-6,
            colour: 2.5e-3,
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
