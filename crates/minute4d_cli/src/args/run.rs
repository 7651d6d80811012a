//! `minute4d run`

use super::{DeviceArgs, LengthArgs, OutArgs, PageArgs, ReachArgs, SettingsArgs, VideoArgs, WithoutArgs, values};
use clap::Args;
use std::path::PathBuf;

/// `minute4d run`
#[derive(Debug, Args)]
pub struct Run {
    /// A video, a folder of images, or a capture folder (whose geometry is then used)
    #[arg(required_unless_present = "print_config")]
    pub input: Option<PathBuf>,
    /// Folder for all results: scene.safetensors, viewer.html, preview.mp4, run.json, metrics.jsonl, capture/
    #[arg(long, short, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// The length of training.
    #[command(flatten)]
    pub length: LengthArgs,
    /// Time limit, such as 90s, 10m or 1.5h: training is shortened to the time left and the preview may be skipped; geometry that
    /// takes longer is saved (exit code 75, continue with --resume)
    #[arg(long, value_name = "TIME", value_parser = values::duration)]
    pub time_limit: Option<f64>,
    /// The part of the video.
    #[command(flatten)]
    pub video: VideoArgs,
    /// The device for training.
    #[command(flatten)]
    pub device: DeviceArgs,
    /// Parts of the method to switch off.
    #[command(flatten)]
    pub without: WithoutArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// The viewer page.
    #[command(flatten)]
    pub page: PageArgs,
    /// What may happen to an existing folder.
    #[command(flatten)]
    pub existing: OutArgs,
    /// Also write poster.jpg, for overviews of many clips.
    #[arg(long, hide = true)]
    pub poster: bool,
    /// Which files a capture may refer to.
    #[command(flatten)]
    pub reach: ReachArgs,
}
