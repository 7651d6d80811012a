//! Learning rates, the optimiser, and what else is refined.

use m4_kernels::adam::cpu::AdamConfig;
use serde::{Deserialize, Serialize};

/// The length that position rates are measured in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PositionUnit {
    /// `max(1.1 * largest distance of a camera from their mean, 0.1 * median depth)` (3DGS; section 3
    /// for the lower bound).
    Extent,
    /// The median depth.
    MedianDepth,
}

/// Learning rates at the start of the run (section 3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RateConfig {
    /// Of means, in units of `position_unit`. 1.6e-4 (3DGS); 3e-4 here, as for colours.
    pub position: f32,
    /// Of means at the end; between them rates fall log-linearly. 1.6e-6 (3DGS); 8e-6
    /// here, as for colours.
    pub position_end: f32,
    /// What `position`, `position_end` and `velocity` are measured in.
    pub position_unit: PositionUnit,
    /// Of constant colours. 2.5e-3 (3DGS); 0.02 here: a dynamic splat is seen in a few dozen steps
    /// (measured on held-out views: +1 to +2 dB after 500 steps, with the other rates alike; faster than this costs
    /// moving parts 0.1 to 0.2 dB in longer runs).
    pub colour: f32,
    /// Of the other colour coefficients. A twentieth of the former (3DGS).
    pub colour_rest: f32,
    /// Of opacities (logit). 0.05 (3DGS): faster ones let what moves become glass that only its own camera
    /// does not see through (measured on held-out views: -0.15 dB inside the moving parts at 0.3).
    pub opacity: f32,
    /// Of scales (logarithm). 0.005 (3DGS); 0.03 here, as for colours.
    pub scale: f32,
    /// Of quaternions. 0.001 (3DGS); 0.006 here, as for colours.
    pub rotation: f32,
    /// Of the middle of a life, frames. Section 3 proposes 0.02, but with a velocity the step moves the
    /// splat along its path, faster than `position` allows: 0 here.
    pub time_mean: f32,
    /// Use the reference's rate instead: `position * (frames - 1) / D` frames, with this D; 0 for no.
    pub time_mean_reference: f32,
    /// Of the logarithm of the standard deviation in time. 0.005, as for scales (reference).
    pub time_sd: f32,
    /// Of velocities, in units of `position_unit` over the first standard deviation in time. 1.6e-4
    /// (section 3); it falls as that of positions does.
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
            position_unit: PositionUnit::Extent,
            colour: 0.02,
            colour_rest: 0.02 / 20.0,
            opacity: 0.05,
            scale: 0.03,
            rotation: 0.006,
            time_mean: 0.0,
            time_mean_reference: 0.0,
            time_sd: 0.005,
            velocity: 1.6e-4,
            other_end: 0.05,
        }
    }
}

impl RateConfig {
    /// Instant4D's rates: no velocity, no rotation, time as the reference (section 3; D7).
    #[must_use]
    pub fn faithful() -> Self {
        Self {
            position: 1.6e-4,
            position_end: 1.6e-6,
            colour: 2.5e-3,
            colour_rest: 2.5e-3 / 20.0,
            opacity: 0.05,
            scale: 0.005,
            rotation: 0.0,
            other_end: 1.0,
            time_mean: 0.0,
            time_mean_reference: 3.0,
            velocity: 0.0,
            ..Self::default()
        }
    }
}

/// Constants of Adam (section 3). The bias of the moments is corrected by each splat's own number of steps, 0 for newborn ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AdamSettings {
    /// Decay of the first moment. 0.9 (3DGS).
    pub beta1: f64,
    /// Decay of the second moment of static splats. 0.999 (3DGS).
    pub beta2: f64,
    /// Decay of the second moment of dynamic splats. 0.99 (section 3): they are seen in few frames.
    pub beta2_dynamic: f64,
    /// Added to the root of the second moment. 1e-15 (3DGS).
    pub eps: f64,
    /// Step only the splats that the frame saw (section 3); false: the dense Adam of the reference.
    pub sparse: bool,
}

impl Default for AdamSettings {
    fn default() -> Self {
        Self {
            beta1: 0.9,
            beta2: 0.999,
            beta2_dynamic: 0.99,
            eps: 1e-15,
            sparse: true,
        }
    }
}

impl AdamSettings {
    /// As the kernel wants them.
    #[must_use]
    pub fn kernel(&self) -> AdamConfig {
        AdamConfig {
            beta1: self.beta1,
            beta2: self.beta2,
            beta2_dynamic: self.beta2_dynamic,
            eps: self.eps,
            sparse: self.sparse,
        }
    }
}

/// Per-frame corrections by their own gradients (section 8, item 4).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
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
    /// Of the logarithm of the focal length. 1e-5 (our choice).
    pub focal_lr: f32,
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
            focal_lr: 1e-5,
            exposure_lr: 5e-4,
            exposure_pull: 1e-3,
        }
    }
}
