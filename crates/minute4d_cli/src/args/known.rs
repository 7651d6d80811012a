//! Who measures flow and outlines what moves, and what the user knows of a clip.

use clap::{Args, ValueEnum};
use minute4d::geometry::{Frontend, UnknownFrontend};
use std::path::PathBuf;

/// Who measures flow and outlines what moves, and what the user knows of a clip.
#[derive(Debug, Args)]
pub struct KnownArgs {
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
    /// The lens: a JSON file with fl_x, fl_y, cx, cy, w and h, or the numbers in pixels of the frames
    #[arg(long, value_name = "FILE|FX,FY,CX,CY")]
    pub intrinsics: Option<String>,
    /// A pose for every frame: transforms.json, or lines "t tx ty tz qx qy qz qw" (camera to world, OpenCV axes)
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,
    /// Masks, a picture for every frame, not black where something moves
    #[arg(long, value_name = "DIR")]
    pub masks: Option<PathBuf>,
    /// Depth, a 16-bit PNG for every frame: millimetres of z-depth, 0 where unknown
    #[arg(long, value_name = "DIR")]
    pub depth: Option<PathBuf>,
}

/// Who outlines what moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Segmenter {
    /// `mobilesam` where its weights are present, and `sam2` after it where its are; else `none`
    Auto,
    /// Nobody: masks are what motion and colours say
    None,
    /// A network; `minute4d weights fetch mobile-sam` gets its weights
    Mobilesam,
    /// SAM 2.1, a network that follows things through the clip; needs the weights of one of its sizes
    Sam2,
}

/// Who follows points of what moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Tracker {
    /// `flow`
    Auto,
    /// Nobody
    None,
    /// Chains of flow, lifted with depth, carried on behind what hides them
    Flow,
    /// A network; its licence forbids commercial use
    Tapip3d,
}

/// A front end by its words.
fn frontend(text: &str) -> Result<Frontend, UnknownFrontend> {
    text.parse()
}
