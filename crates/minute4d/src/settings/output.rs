//! Settings that change no scene: time limit, checkpoints, preview, page.

use serde::{Deserialize, Serialize};

/// How long a run may take.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LimitConfig {
    /// Seconds from start to end; 0 for as long as it takes. Training is planned to end in time,
    /// and ended where it would not. Geometry that takes longer is saved and resumes with the next
    /// attempt.
    pub time_s: f64,
}

/// When training is saved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CheckpointConfig {
    /// Seconds between two checkpoints. 30: what a person is willing to lose.
    pub every_s: f64,
    /// How many are kept. 2: one is whole even when the other cannot be read.
    pub keep: usize,
}

impl Default for CheckpointConfig {
    fn default() -> Self {
        Self {
            every_s: 30.0,
            keep: 2,
        }
    }
}

/// Shape of the clip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PreviewConfig {
    /// Longest side of each of the three panels, pixels. 480: three fit on a full-HD screen.
    pub panel_px: usize,
}

impl Default for PreviewConfig {
    fn default() -> Self {
        Self { panel_px: 480 }
    }
}

/// Contents of the page of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ViewerConfig {
    /// Write `viewer.html` at the end of a run.
    pub write: bool,
}

impl Default for ViewerConfig {
    fn default() -> Self {
        Self { write: true }
    }
}
