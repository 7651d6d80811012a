//! How often a scene is sampled.

use serde::{Deserialize, Serialize};

/// How places are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum UsdPositions {
    /// At the two ends of the clip: exact, since splats move along lines and USD interpolates linearly.
    #[default]
    Ends,
    /// At every sample, for tools that read samples and do not interpolate. Several times larger.
    EverySample,
}

/// Settings of [`super::write()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UsdOptions {
    /// Frames from one sample of the opacities to the next, at least 1; the last frame is always one.
    /// Default 1: every frame.
    pub step_frames: usize,
    /// Frames a second of the clip. Default: as recorded, or 30 where that is not known.
    pub fps: Option<f64>,
    /// How places are written. Default: at the two ends.
    pub positions: UsdPositions,
}

impl Default for UsdOptions {
    fn default() -> Self {
        Self {
            step_frames: 1,
            fps: None,
            positions: UsdPositions::Ends,
        }
    }
}
