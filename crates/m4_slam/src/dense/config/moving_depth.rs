//! Settings of depth of what moves, from what it touches.

use super::check::shares;
use crate::dense::DenseError;
use serde::{Deserialize, Serialize};

/// Depth of what moves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MovingDepthConfig {
    /// Time over which depth is smoothed along the flow, frames (decay by e).
    pub smooth_frames: f32,
    /// Power of the disparity that is averaged: 1 for the plain mean, more to favour the nearest.
    /// Measured with 8 frames: 4 takes the error of falling toys from 0.34 to 0.27 of their depth and
    /// costs what stays on the ground 0.01 to 0.02.
    pub power: f32,
    /// Flow whose round trip misses by more than this is not followed, pixels at the working size.
    pub round_trip_px: f32,
    /// Lowest share of a part's height in which it may touch the ground.
    pub feet_share: f32,
    /// How far under a part's lowest pixels the ground is read, pixels at the working size.
    pub below_px: usize,
    /// Share of the background behind a part that the part must be in front of.
    pub hidden_quantile: f64,
}

impl Default for MovingDepthConfig {
    fn default() -> Self {
        Self {
            smooth_frames: 8.0,
            power: 4.0,
            round_trip_px: 2.0,
            feet_share: 0.1,
            below_px: 3,
            hidden_quantile: 0.98,
        }
    }
}

impl MovingDepthConfig {
    /// Rejects settings that no computation could use: [`DenseError::Setting`].
    pub(super) fn check(&self) -> Result<(), DenseError> {
        shares(&[("dense.moving_depth.hidden_quantile", self.hidden_quantile)])
    }
}
