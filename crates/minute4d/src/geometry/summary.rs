//! What the geometry stage measured, for its record and the log.

use super::{Confidence, Footage};
use crate::networks::UsedNetwork;
use serde::{Deserialize, Serialize};

/// The results of the geometry stage.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct GeometrySummary {
    /// Frames of the capture.
    pub frames: usize,
    /// Their size, pixels.
    pub size: [usize; 2],
    /// Horizontal focal length, pixels.
    pub focal_px: f64,
    /// The same as a field of view, degrees.
    pub fov_deg: f64,
    /// `parallax`, `rotation_only` or `static`.
    pub camera_motion: String,
    /// Median reprojection error of static regions, pixels.
    pub residual_px: f64,
    /// Number of feature tracks.
    pub tracks: usize,
    /// Number of triangulated tracks.
    pub points: usize,
    /// Share of all pixels that are dynamic.
    pub moving_share: f64,
    /// Number of point tracks in dynamic regions, in `tracks.npz`.
    #[serde(default)]
    pub moving_tracks: usize,
    /// The front end: `classical`, `raft`, `megasam+raft+moge`, ...
    #[serde(default)]
    pub frontend: String,
    /// The networks of the front end, with the licences of their weights.
    #[serde(default)]
    pub networks: Vec<UsedNetwork>,
    /// Number of keyframes of the tracking network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keyframes: Option<Vec<usize>>,
    /// Units of MegaSaM's own files (disparities whose 98th percentile is 2) a metre, where depth
    /// is metric.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub megasam_units_a_metre: Option<f64>,
    /// The segmentation method: `none`, `mobilesam`.
    #[serde(default)]
    pub segmenter: String,
    /// The geometry that the user provided: `intrinsics`, `poses`, `masks`, `depth`.
    #[serde(default)]
    pub given: Vec<String>,
    /// Cuts, repeated frames, bars and the like, and what was done about them; `None` for one
    /// continuous take.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub footage: Option<Footage>,
    /// How often depth and masks were computed: twice if the masks changed the cameras.
    #[serde(default = "once")]
    pub rounds: usize,
    /// The confidence.
    #[serde(default)]
    pub confidence: Option<Confidence>,
}

/// Defaults for records of earlier releases.
fn once() -> usize {
    1
}
