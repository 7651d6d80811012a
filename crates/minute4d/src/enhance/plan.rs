//! Settings of the stage, and its methods by the installed weights.

use crate::Error;
use crate::error::NetworkMethod;
use crate::networks::{UsedNetwork, network};
use crate::settings::{Segmenter, Tracker};
use std::path::PathBuf;

/// Sizes of SAM 2.1, the best first.
const SAM2: [&str; 4] = [
    "sam2.1-large",
    "sam2.1-base-plus",
    "sam2.1-small",
    "sam2.1-tiny",
];

/// The segmentation method.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Segmentation {
    /// Masks stay unchanged.
    Unchanged,
    /// Optical flow, with MobileSAM for single images.
    Mobilesam,
    /// SAM 2.1.
    Sam2(PathBuf),
}

/// The tracking method.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Tracking {
    /// Tracks stay unchanged.
    Unchanged,
    /// Chains of flow.
    Flow,
    /// TAPIP3D.
    Tapip3d(PathBuf),
}

/// The methods, whose weights were found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Plan {
    pub(super) segmentation: Segmentation,
    pub(super) tracking: Tracking,
    /// The networks.
    pub used: Vec<UsedNetwork>,
}

/// What has been done before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Before {
    /// Masks that a segmenter of single images sharpened, and chains of flow: only networks with a
    /// memory can add to them.
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
            Segmentation::Mobilesam => Segmenter::Mobilesam.name(),
            Segmentation::Sam2(_) => Segmenter::Sam2.name(),
        }
    }

    /// As records name the tracking method.
    pub fn tracker(&self) -> &'static str {
        match self.tracking {
            Tracking::Unchanged => Tracker::None.name(),
            Tracking::Flow => Tracker::Flow.name(),
            Tracking::Tapip3d(_) => Tracker::Tapip3d.name(),
        }
    }

    /// Finds the methods; fails if weights are missing, or the build has no networks.
    pub fn of(segmenter: Segmenter, tracker: Tracker, before: Before) -> Result<Self, Error> {
        let by_flow = before == Before::Motion && matches!(tracker, Tracker::Auto | Tracker::Flow);
        let tracking = if by_flow {
            Tracking::Flow
        } else {
            Tracking::Unchanged
        };
        let mut plan = Self {
            segmentation: Segmentation::Unchanged,
            tracking,
            used: Vec::new(),
        };
        let method = NetworkMethod::Segmenter(segmenter);
        let auto = segmenter == Segmenter::Auto;
        let single = segmenter == Segmenter::Mobilesam;
        let sam2 = segmenter == Segmenter::Sam2;
        if (auto || sam2)
            && let Some((network, path)) = network(&SAM2, sam2, method)?
        {
            plan.used.push(network);
            plan.segmentation = Segmentation::Sam2(path);
        } else if (auto || single)
            && before == Before::Motion
            && let Some((network, _)) = network(&["mobile-sam"], single, method)?
        {
            plan.used.push(network);
            plan.segmentation = Segmentation::Mobilesam;
        }
        if tracker == Tracker::Tapip3d
            && let Some((network, path)) =
                network(&["tapip3d"], true, NetworkMethod::Tracker(tracker))?
        {
            plan.used.push(network);
            plan.tracking = Tracking::Tapip3d(path);
        }
        Ok(plan)
    }
}
