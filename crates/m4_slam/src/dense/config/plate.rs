//! Settings of masks against the clean plate.

use super::check::{above_zero, need, shares, whole};
use crate::dense::DenseError;
use serde::{Deserialize, Serialize};

/// Masks against the clean plate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlateConfig {
    /// Distances in time of the frames that a plate is made of, each both ways.
    pub reaches: Vec<usize>,
    /// Fewest frames that must have seen a pixel of the background.
    pub least_frames: usize,
    /// How far beyond its mask a part may reach, pixels at the working size.
    pub margin_px: usize,
    /// How far masks are grown before other frames' pixels are believed to be background, pixels.
    pub guard_px: usize,
    /// Difference in colour (0..255, mean of 5x5 pixels) that is as likely motion as not.
    pub step: f32,
    /// The same outside of the mask so far.
    pub step_outside: f32,
    /// Darkest shadow, as a share of the light.
    pub least_gain: f32,
    /// What it costs to explain a difference by a shadow, 0..255 for full darkness.
    pub gain_cost: f32,
    /// Weight of the mask so far; a pixel of the plate has 1.
    pub prior: f32,
    /// Strength of the edge-aware smoothing, pixels squared (Min et al. 2014, lambda).
    pub smooth_lambda: f32,
}

impl Default for PlateConfig {
    fn default() -> Self {
        Self {
            reaches: vec![2, 5, 9, 14, 20],
            least_frames: 2,
            margin_px: 6,
            guard_px: 2,
            step: 20.0,
            step_outside: 32.0,
            least_gain: 0.4,
            gain_cost: 20.0,
            prior: 0.3,
            smooth_lambda: 10.0,
        }
    }
}

impl PlateConfig {
    /// Rejects settings that no computation could use: [`DenseError::Setting`].
    pub(super) fn check(&self) -> Result<(), DenseError> {
        whole(&[
            ("dense.plate.margin_px", self.margin_px, 0, 100),
            ("dense.plate.guard_px", self.guard_px, 0, 100),
            ("dense.plate.least_frames", self.least_frames, 1, 1000),
        ])?;
        let reach = self.reaches.iter().copied().min().unwrap_or(0);
        need(
            reach > 0,
            "dense.plate.reaches",
            reach as f64,
            "a list of frames, each 1 or more",
        )?;
        above_zero(&[
            ("dense.plate.step", self.step.into()),
            ("dense.plate.step_outside", self.step_outside.into()),
            ("dense.plate.smooth_lambda", self.smooth_lambda.into()),
        ])?;
        shares(&[("dense.plate.least_gain", self.least_gain.into())])
    }
}
