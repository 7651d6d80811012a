//! `minute4d render`: renders images or a video of a scene.

use crate::failure::Failure;
use crate::options::{rate, render_size};
use crate::output::Output;
use clap::Args;
use minute4d::device::DeviceChoice;
use minute4d::render::{CameraPath, Moment, PathOptions, RenderJob};
use serde_json::json;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct Render {
    /// The folder of a run, or a scene file
    pub scene: PathBuf,
    /// Camera path: `train` (the camera of every frame), `source` (the source camera at any frame
    /// rate), `stabilised`, `swing`, `bullet`, `test:TRANSFORMS` (a file of held-out views), or a
    /// file of cameras or keyframes (docs/paths.md)
    #[arg(long, value_name = "PATH", default_value = "train")]
    pub path: String,
    /// Scene time: `source` (that of each camera), `play` (at the speed of the source, in a loop),
    /// or `freeze@T`; T is a frame number, or seconds with the suffix `s`, as in freeze@1.5s
    #[arg(long, value_name = "TIME", default_value = "source")]
    pub time: String,
    /// Output: a folder for PNG images, an .mp4 file, or a .png file for a single image
    #[arg(long, short, value_name = "DIR|FILE.mp4|FILE.png")]
    pub out: PathBuf,
    /// Frames per second [default: the rate of the camera file or of the source]
    #[arg(long, value_name = "FPS", value_parser = rate)]
    pub fps: Option<f64>,
    /// Size of the images in pixels; a view of another aspect ratio is cropped [default: that of
    /// the cameras]
    #[arg(long, value_name = "WxH", value_parser = render_size)]
    pub size: Option<(usize, usize)>,
    /// Duration in seconds; `source`, `stabilised` and keyframes are played slower or faster to fit
    #[arg(
        long,
        value_name = "S",
        allow_negative_numbers = true,
        help_heading = "Camera paths"
    )]
    pub seconds: Option<f64>,
    /// The time in the video from whose camera a path starts (default: the middle, or T of
    /// `freeze@T`). For `bullet`, the time that is frozen; for `train`, `source` and `stabilised`,
    /// render only this image
    #[arg(long, value_name = "T", help_heading = "Camera paths")]
    pub at: Option<String>,
    /// `swing`, `bullet`: maximum rotation to either side, degrees
    #[arg(
        long,
        value_name = "DEG",
        allow_negative_numbers = true,
        help_heading = "Camera paths"
    )]
    pub degrees: Option<f64>,
    /// Device that renders: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or
    /// `auto` (the best GPU, falling back to the CPU)
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    pub device: DeviceChoice,
    /// Replace existing images or an existing video
    #[arg(long)]
    pub force: bool,
}

pub fn run(args: &Render, output: &Output) -> Result<(), Failure> {
    let usage = minute4d::Error::from;
    let at = args.at.as_deref().map(str::parse::<Moment>).transpose();
    let job = RenderJob {
        options: PathOptions {
            seconds: args.seconds,
            at: at.map_err(usage)?,
            degrees: args.degrees,
        },
        time: args.time.parse().map_err(usage)?,
        fps: args.fps,
        size: args.size,
        replace: args.force,
        device: args.device,
        ..RenderJob::new(CameraPath::named(&args.path))
    };
    let done = minute4d::render::make(&args.scene, &args.out, &job, output)?;
    Ok(output.result(
        args.out.display(),
        &json!({
            "path": args.out,
            "frames": done.frames,
            "fps": done.fps,
            "width": done.size.0,
            "height": done.size.1,
            "seconds": done.seconds,
            "device": done.device,
        }),
    )?)
}
