//! `minute4d render`

use super::device::device;
use super::values::{number, picture_size, rate};
use clap::{Args, ValueEnum};
use minute4d::device::DeviceChoice;
use std::path::PathBuf;

/// `minute4d render`
#[derive(Debug, Args)]
pub struct Render {
    /// The folder of a run, or a scene file
    pub scene: PathBuf,
    /// Cameras: `train` (every frame of the video), `source` (the same camera at any frame rate), `stabilised`,
    /// `swing`, `bullet`, `test:TRANSFORMS` (a file of held-out views), or a file of cameras or keyframes (docs/paths.md)
    #[arg(long, value_name = "PATH", default_value = "train")]
    pub path: String,
    /// Time: `source` (each camera's own), `play` (the speed of the source, over and over), `freeze@T`, or `A..B`;
    /// T, A and B count frames, or seconds with an `s` behind, as in freeze@1.5s
    #[arg(long, value_name = "TIME", default_value = "source")]
    pub time: String,
    /// A folder for PNG pictures, a name that ends in .mp4, or one in .png where there is one picture
    #[arg(long, short, value_name = "DIR|FILE.mp4|FILE.png")]
    pub out: PathBuf,
    /// Pictures a second [default: those of the file of cameras or of the source]
    #[arg(long, value_name = "FPS", value_parser = rate)]
    pub fps: Option<f64>,
    /// Size of the pictures, pixels [default: that of the cameras]
    #[arg(long, value_name = "WxH", value_parser = picture_size)]
    pub size: Option<(usize, usize)>,
    /// If the aspect ratio differs from that of the cameras: crop the view, or extend it
    #[arg(long, value_enum, default_value = "crop", requires = "size")]
    pub fit: FitArg,
    /// Zoom factor; above 1 narrows the field of view
    #[arg(long, value_name = "F", default_value_t = 1.0, value_parser = zoom)]
    pub zoom: f64,
    /// Length, seconds; `source`, `stabilised` and keyframes are played slower or faster
    #[arg(long, value_name = "S", allow_negative_numbers = true, help_heading = "Camera paths")]
    pub seconds: Option<f64>,
    /// The moment of the video whose camera a path starts from [default: the middle; that of freeze@T]. For `bullet`,
    /// where time stands still; for `train`, `source` and `stabilised`, the one picture that is wanted
    #[arg(long, value_name = "T", help_heading = "Camera paths")]
    pub at: Option<String>,
    /// Scale the recommended camera motion by this factor, -10 to 10
    #[arg(long, value_name = "F", allow_negative_numbers = true, help_heading = "Camera paths")]
    pub amount: Option<f64>,
    /// `swing`, `bullet`: greatest turn to either side
    #[arg(
        long,
        value_name = "DEG",
        allow_negative_numbers = true,
        help_heading = "Camera paths"
    )]
    pub degrees: Option<f64>,
    /// `stabilised`: seconds that are averaged over, standard deviation [default: 0.5]
    #[arg(long, value_name = "S", help_heading = "Camera paths")]
    pub smooth_s: Option<f64>,
    /// `stabilised`: from 0, the source, to 1 [default: 1]
    #[arg(long, value_name = "F", help_heading = "Camera paths")]
    pub strength: Option<f64>,
    /// `bullet`: seconds for which time stands still [default: 4]
    #[arg(long, value_name = "S", help_heading = "Camera paths")]
    pub hold_s: Option<f64>,
    /// Where pictures are drawn: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or `auto` (a GPU
    /// where there is one that is more than software)
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = device)]
    pub device: DeviceChoice,
    /// Replace pictures or a video that are already there
    #[arg(long)]
    pub force: bool,
}

/// What happens where pictures have another shape than the cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FitArg {
    /// The middle of the view fills the picture
    Crop,
    /// All of the view is in the picture, and more beside it
    Extend,
}

fn zoom(text: &str) -> Result<f64, String> {
    match number(text)? {
        factor if (0.1..=10.0).contains(&factor) => Ok(factor),
        _ => Err("it must lie between 0.1 and 10".to_owned()),
    }
}
