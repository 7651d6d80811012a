//! Who measures flow and outlines what moves, and what the user knows of a clip.

use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Who measures flow and outlines what moves, and what the user knows of a clip.
#[derive(Debug, Args)]
pub struct KnownArgs {
    /// Who measures flow between frames [default: auto]
    #[arg(long, value_enum)]
    pub frontend: Option<Frontend>,
    /// Who outlines what moves [default: auto]
    #[arg(long, value_enum)]
    pub segmenter: Option<Segmenter>,
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

/// Who measures flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Frontend {
    /// The best that pays on this machine's processor
    Auto,
    /// A search that needs no weights
    Classical,
    /// A network; `minute4d weights fetch gmflow` gets its weights
    Gmflow,
}

/// Who outlines what moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Segmenter {
    /// `mobilesam` where its weights are present, else `none`
    Auto,
    /// Nobody: masks are what motion and colours say
    None,
    /// A network; `minute4d weights fetch mobile-sam` gets its weights
    Mobilesam,
}
