//! Settings of the enhancement.

use m4_geometry::masks::RefineSettings;
use serde::{Deserialize, Serialize};

/// Tracking method of dynamic points.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tracker {
    /// [`Self::Flow`].
    #[default]
    Auto,
    /// Nobody.
    None,
    /// Chains of flow, lifted with depth and carried on behind what hides them; needs no weights.
    Flow,
    /// TAPIP3D, a pretrained network; needs its weights.
    Tapip3d,
}

impl Tracker {
    /// As options and records name it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::None => "none",
            Self::Flow => "flow",
            Self::Tapip3d => "tapip3d",
        }
    }
}

/// Masks over time, and points followed in three dimensions (section 3.2 of the paper).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EnhanceConfig {
    /// How things are found and told apart.
    pub masks: RefineSettings,
    /// What TAPIP3D is asked.
    pub tapip3d: Tapip3dConfig,
}

/// What TAPIP3D is asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Tapip3dConfig {
    /// Points start in every n-th frame. Paper: 10 for DyCheck and DAVIS, 1 for NVIDIA.
    pub every: usize,
    /// Distance of the points, pixels of frames of at most 480 on their longer side.
    pub spacing_px: usize,
    /// Most points; more are thinned everywhere alike. 4,096: the specification's, since time grows with them.
    pub most: usize,
    /// Times that each window of 16 frames is revised. Published: 6.
    pub iterations: usize,
    /// Frames are brought to this share of the published sides (724 x 543 for a network of 512 x 384): 1, or less where time counts.
    pub size: f64,
    /// Megabytes to work with: more lets more points be followed together.
    pub memory_mb: usize,
}

impl Default for Tapip3dConfig {
    fn default() -> Self {
        Self { every: 10, spacing_px: 4, most: 4096, iterations: 6, size: 1.0, memory_mb: 2000 }
    }
}
