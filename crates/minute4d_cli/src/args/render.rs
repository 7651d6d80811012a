//! `minute4d render`

use super::values::rate;
use clap::Args;
use std::path::PathBuf;

/// `minute4d render`
#[derive(Debug, Args)]
pub struct Render {
    /// The folder of a run, or a scene file
    pub scene: PathBuf,
    /// Cameras: `train` (those of the video), `swing` (an arc about the middle of the scene),
    /// `test:TRANSFORMS` (a file of held-out views), or a transforms file
    #[arg(long, value_name = "PATH", default_value = "train")]
    pub path: String,
    /// Time: `source` (each camera's own), `freeze@T`, or `A..B`; T, A and B count frames, or seconds
    /// with an `s` behind, as in freeze@1.5s
    #[arg(long, value_name = "TIME", default_value = "source")]
    pub time: String,
    /// A folder for PNG pictures, or a name that ends in .mp4
    #[arg(long, short, value_name = "DIR|FILE.mp4")]
    pub out: PathBuf,
    /// Frames a second of an MP4 [default: that of the source]
    #[arg(long, value_name = "FPS", value_parser = rate)]
    pub fps: Option<f64>,
    /// Replace pictures or a video that are already there
    #[arg(long)]
    pub force: bool,
}
