//! Settings of the page.

use m4_viewer::FrameLimits;
use serde::{Deserialize, Serialize};

/// Contents of the page of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ViewerConfig {
    /// Write `viewer.html` at the end of a run.
    pub write: bool,
    /// The frames of the source, shown beside the scene.
    pub frames: FrameLimits,
}

impl Default for ViewerConfig {
    fn default() -> Self {
        Self {
            write: true,
            frames: FrameLimits::default(),
        }
    }
}

/// Update interval of an open page during training; not part of the result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LiveConfig {
    /// Least seconds between two scenes. 2: a person does not follow more.
    pub every_s: f64,
    /// Most of the machine's time that scenes for the page may take; when they would take more there are
    /// fewer. 0.03: not noticed.
    pub share: f64,
}

impl Default for LiveConfig {
    fn default() -> Self {
        Self {
            every_s: 2.0,
            share: 0.03,
        }
    }
}
