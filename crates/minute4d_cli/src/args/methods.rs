//! Methods of the geometry stage, and geometry that the user provides.

use clap::{Args, ValueEnum};
use minute4d::geometry::{Frontend, UnknownFrontend};
use std::path::PathBuf;

/// Methods of the geometry stage, and geometry that the user provides.
#[derive(Debug, Args)]
pub struct MethodArgs {
    /// Front end, the methods for camera poses, optical flow and monocular depth: `auto`, or parts joined by `+`: `megasam` (poses, by a
    /// network), `classical`, `raft` (flow), `moge`, `unidepth`, `depth-anything` (depth); all but `classical` need weights (`minute4d
    /// weights list`) [default: auto]
    #[arg(long, value_name = "WORD+WORD", value_parser = frontend)]
    pub frontend: Option<Frontend>,
    /// Segmentation method [default: auto]
    #[arg(long, value_enum)]
    pub segmenter: Option<Segmenter>,
    /// Tracking method [default: auto]
    #[arg(long, value_enum)]
    pub tracker: Option<Tracker>,
    /// Camera intrinsics: a JSON file with fl_x, fl_y, cx, cy, w and h, or the numbers, in pixels of the frames
    #[arg(long, value_name = "FILE|FX,FY,CX,CY")]
    pub intrinsics: Option<String>,
    /// Camera poses, one per frame: transforms.json, or lines "t tx ty tz qx qy qz qw" (camera to world, OpenCV axes)
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,
    /// Folder of masks, one image per frame, not black where the scene is dynamic
    #[arg(long, value_name = "DIR")]
    pub masks: Option<PathBuf>,
    /// Folder of depth maps, one 16-bit PNG per frame: z-depth in millimetres, 0 where unknown
    #[arg(long, value_name = "DIR")]
    pub depth: Option<PathBuf>,
}

/// The segmentation method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Segmenter {
    /// `mobilesam` if its weights are installed, then `sam2` if its weights are; otherwise `none`
    Auto,
    /// No network: masks from motion and colour only
    None,
    /// MobileSAM; `minute4d weights fetch mobile-sam` installs its weights
    Mobilesam,
    /// SAM 2.1, which tracks objects through the clip; needs the weights of one of its sizes
    Sam2,
}

/// The tracking method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Tracker {
    /// `flow`
    Auto,
    /// No tracking
    None,
    /// Chained optical flow, lifted to 3D with depth and continued through occlusions
    Flow,
    /// TAPIP3D, a network whose licence forbids commercial use
    Tapip3d,
}

/// Parses the parts of a front end.
fn frontend(text: &str) -> Result<Frontend, UnknownFrontend> {
    text.parse()
}
