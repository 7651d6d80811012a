//! Settings of the stage itself.

use super::{Frontend, Segmenter};
use crate::enhance::Tracker;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Who measures flow, and what the user knows already. Files are hashed with the input: another content is another
/// result.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeometryOptions {
    /// Who measures flow.
    pub frontend: Frontend,
    /// Who outlines what moves.
    pub segmenter: Segmenter,
    /// Who follows points of it.
    pub tracker: Tracker,
    /// The lens: `fx,fy,cx,cy` in pixels of the frames (principal point from the image's corner), or a JSON file with
    /// `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h`.
    pub intrinsics: Option<String>,
    /// Poses a frame: a `transforms.json`, or a trajectory of lines `t tx ty tz qx qy qz qw` (camera to world, OpenCV
    /// axes).
    pub poses: Option<PathBuf>,
    /// A folder of masks, one a frame, not black where something moves.
    pub masks: Option<PathBuf>,
    /// A folder of depth maps, one a frame: greyscale PNG of 16 bits, millimetres of z-depth, 0 where unknown.
    pub depth: Option<PathBuf>,
}

impl GeometryOptions {
    /// True when the user gave anything that replaces what would be computed.
    #[must_use]
    pub fn any_given(&self) -> bool {
        self.intrinsics.is_some() || self.poses.is_some() || self.masks.is_some() || self.depth.is_some()
    }
}
