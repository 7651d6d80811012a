//! Methods of geometry, segmentation and tracking, and what the user knows already.

use super::Frontend;
use m4_geometry::masks::RefineSettings;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Methods of the geometry stage, and what the user knows already. Files are hashed with the input:
/// another content is another result.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeometryOptions {
    /// Front end.
    pub frontend: Frontend,
    /// Segmentation method.
    pub segmenter: Segmenter,
    /// Tracking method.
    pub tracker: Tracker,
    /// The shot of a clip with cuts, in order of time from 1; the longest where it is not set.
    pub shot: Option<usize>,
    /// The lens: `fx,fy,cx,cy` in pixels of the frames (principal point from the image's corner),
    /// or a JSON file with `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h` and, where the lens has
    /// distortion, the coefficients and `camera_model` of nerfstudio.
    pub intrinsics: Option<String>,
    /// Poses of the frames: a `transforms.json`.
    pub poses: Option<PathBuf>,
    /// A folder of masks, one a frame, not black where something moves.
    pub masks: Option<PathBuf>,
    /// A folder of depth maps, one a frame: greyscale PNG of 16 bits, millimetres of z-depth, 0
    /// where unknown.
    pub depth: Option<PathBuf>,
}

impl GeometryOptions {
    /// The files and folders of the user among them.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let intrinsics = self.intrinsics.as_deref().map(Path::new);
        let paths = [
            self.poses.as_deref(),
            self.masks.as_deref(),
            self.depth.as_deref(),
        ];
        paths
            .into_iter()
            .flatten()
            .chain(intrinsics.filter(|path| path.is_file()))
    }

    /// True when the user gave anything that replaces what would be computed.
    pub fn any_given(&self) -> bool {
        self.intrinsics.is_some() || self.per_frame_given()
    }

    /// True when the user gave something for each frame.
    pub fn per_frame_given(&self) -> bool {
        self.poses.is_some() || self.masks.is_some() || self.depth.is_some()
    }
}

/// The segmentation method.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Segmenter {
    /// [`Self::Mobilesam`] where its weights are present, else [`Self::None`], and [`Self::Sam2`]
    /// after it where its are: see `docs/geometry.md`.
    #[default]
    Auto,
    /// Masks are what motion and colours say.
    None,
    /// MobileSAM, a pretrained network; needs its weights.
    Mobilesam,
    /// SAM 2.1, a pretrained network with a memory, which follows things through the clip; needs
    /// the weights of one of its sizes.
    Sam2,
}

impl Segmenter {
    /// As options and records name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::None => "none",
            Self::Mobilesam => "mobilesam",
            Self::Sam2 => "sam2",
        }
    }
}

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
    /// Most points; more are thinned everywhere alike. 4,096: the specification's, since time grows
    /// with them.
    pub most: usize,
    /// Times that each window of 16 frames is revised. Published: 6.
    pub iterations: usize,
    /// Frames are brought to this share of the published sides (724 x 543 for a network of 512 x
    /// 384): 1, or less where time counts.
    pub size: f64,
    /// Megabytes to work with: more lets more points be followed together.
    pub memory_mb: usize,
}

impl Default for Tapip3dConfig {
    fn default() -> Self {
        Self {
            every: 10,
            spacing_px: 4,
            most: 4096,
            iterations: 6,
            size: 1.0,
            memory_mb: 2000,
        }
    }
}
