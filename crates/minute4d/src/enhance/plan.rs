//! Settings of the stage, and its methods by the installed weights.

use crate::Error;
#[cfg(not(feature = "nets"))]
use crate::error::NetworkError;
use crate::error::NetworkMethod;
use crate::geometry::{Segmenter, UsedNetwork};
use m4_geometry::masks::RefineSettings;
use serde::{Deserialize, Serialize};
#[cfg(feature = "nets")]
use std::path::PathBuf;

/// Sizes of SAM 2.1, the best first.
#[cfg(feature = "nets")]
const SAM2: [&str; 4] = ["sam2.1-large", "sam2.1-base-plus", "sam2.1-small", "sam2.1-tiny"];

/// Tracking method of dynamic points.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tracker {
    /// [`Self::Flow`].
    #[default]
    Auto,
    /// Points are not tracked.
    None,
    /// Chains of flow, lifted with depth and carried on behind what hides them; needs no weights.
    Flow,
    /// TAPIP3D, a pretrained network; needs its weights.
    Tapip3d,
}

impl Tracker {
    /// As options and records name it.
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
    /// How objects are found and separated.
    pub masks: RefineSettings,
    /// Options of TAPIP3D.
    pub tapip3d: Tapip3dConfig,
}

/// Options of TAPIP3D.
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

/// The segmentation method.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Segmentation {
    /// Masks stay unchanged.
    Unchanged,
    /// Optical flow, with MobileSAM for single images.
    #[cfg(feature = "nets")]
    Mobilesam,
    /// SAM 2.1.
    #[cfg(feature = "nets")]
    Sam2(PathBuf),
}

/// The tracking method.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Tracking {
    /// Tracks stay unchanged.
    Unchanged,
    /// Chains of flow.
    Flow,
    /// TAPIP3D.
    #[cfg(feature = "nets")]
    Tapip3d(PathBuf),
}

/// The methods, whose weights were found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Plan {
    pub segmentation: Segmentation,
    pub tracking: Tracking,
    /// The networks.
    pub used: Vec<UsedNetwork>,
}

/// What has been done before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Before {
    /// Masks that a segmenter of single images sharpened, and chains of flow: only networks with a memory can add to them.
    Classical,
    /// A map of how likely each pixel moves, and no tracks.
    Motion,
}

impl Plan {
    /// Nothing is done.
    pub fn nothing(&self) -> bool {
        self.segmentation == Segmentation::Unchanged && self.tracking == Tracking::Unchanged
    }

    /// Whether a network is among them.
    pub fn has_network(&self) -> bool {
        !self.used.is_empty()
    }

    /// As records name the segmentation method.
    pub fn segmenter(&self) -> &'static str {
        match self.segmentation {
            Segmentation::Unchanged => Segmenter::None.name(),
            #[cfg(feature = "nets")]
            Segmentation::Mobilesam => Segmenter::Mobilesam.name(),
            #[cfg(feature = "nets")]
            Segmentation::Sam2(_) => Segmenter::Sam2.name(),
        }
    }

    /// As records name the tracking method.
    pub fn tracker(&self) -> &'static str {
        match self.tracking {
            Tracking::Unchanged => Tracker::None.name(),
            Tracking::Flow => Tracker::Flow.name(),
            #[cfg(feature = "nets")]
            Tracking::Tapip3d(_) => Tracker::Tapip3d.name(),
        }
    }

    /// Finds the methods; fails if weights are missing, or the build has no networks.
    pub fn of(segmenter: Segmenter, tracker: Tracker, before: Before) -> Result<Self, Error> {
        let by_flow = before == Before::Motion && matches!(tracker, Tracker::Auto | Tracker::Flow);
        let tracking = if by_flow { Tracking::Flow } else { Tracking::Unchanged };
        let plan = Self { segmentation: Segmentation::Unchanged, tracking, used: Vec::new() };
        plan.with_networks(segmenter, tracker, before)
    }

    #[cfg(feature = "nets")]
    fn with_networks(mut self, segmenter: Segmenter, tracker: Tracker, before: Before) -> Result<Self, Error> {
        use crate::geometry::network;

        let method = NetworkMethod::Segmenter(segmenter);
        let (auto, single) = (segmenter == Segmenter::Auto, segmenter == Segmenter::Mobilesam);
        let sam2 = segmenter == Segmenter::Sam2;
        if (auto || sam2)
            && let Some((network, path)) = network(&SAM2, sam2, method)?
        {
            self.used.push(network);
            self.segmentation = Segmentation::Sam2(path);
        } else if (auto || single)
            && before == Before::Motion
            && let Some((network, _)) = network(&["mobile-sam"], single, method)?
        {
            self.used.push(network);
            self.segmentation = Segmentation::Mobilesam;
        }
        if tracker == Tracker::Tapip3d
            && let Some((network, path)) = network(&["tapip3d"], true, NetworkMethod::Tracker(tracker))?
        {
            self.used.push(network);
            self.tracking = Tracking::Tapip3d(path);
        }
        Ok(self)
    }

    #[cfg(not(feature = "nets"))]
    fn with_networks(self, segmenter: Segmenter, tracker: Tracker, _: Before) -> Result<Self, Error> {
        let method = match (segmenter, tracker) {
            (Segmenter::Mobilesam | Segmenter::Sam2, _) => NetworkMethod::Segmenter(segmenter),
            (_, Tracker::Tapip3d) => NetworkMethod::Tracker(tracker),
            _ => return Ok(self),
        };
        Err(NetworkError::NotBuilt { method }.into())
    }
}
