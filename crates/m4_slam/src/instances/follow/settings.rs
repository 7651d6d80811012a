//! Settings of following by flow.

use crate::dense::SegmentConfig;
use serde::{Deserialize, Serialize};

/// Settings of [`super::FlowFollower`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FollowSettings {
    /// Longest side of the pictures between which flow is measured, pixels; as [`crate::dense::DenseConfig::working_side_px`].
    pub flow_side_px: usize,
    /// A pixel whose way there and back misses by this much counts half, pixels of the masks' size.
    pub round_trip_px: f32,
    /// Strength of the smoothing of a carried mask along the edges of the frame, pixels squared.
    pub smooth_lambda: f32,
    /// How wide of its edge a coarse part may be, pixels: nearer to the edge than this, colours decide more than the part does, where there is no
    /// segmenter.
    pub rim_px: f32,
    /// Colour difference (0..255) over which neighbours stop to speak for one another.
    pub edge_sigma: f32,
    /// A thing of which less than this share arrives in the next frame is lost.
    pub least_kept: f32,
    /// A thing of a smaller share of the picture is lost.
    pub least_share: f32,
    /// How a segmenter of single pictures is asked, and when its answer is taken in place of the carried mask.
    pub segment: SegmentConfig,
}

impl Default for FollowSettings {
    fn default() -> Self {
        Self {
            flow_side_px: 480,
            round_trip_px: 1.0,
            smooth_lambda: 40.0,
            rim_px: 6.0,
            edge_sigma: 8.0,
            least_kept: 0.2,
            least_share: 0.0003,
            segment: SegmentConfig::default(),
        }
    }
}
