//! `minute4d run`

use super::{DeviceArgs, LengthArgs, OutArgs, PageArgs, ReachArgs, SettingsArgs, VideoArgs, WithoutArgs, values};
use clap::Args;
use std::path::PathBuf;

/// `minute4d run`
#[derive(Debug, Args)]
pub struct Run {
    /// A video, a folder of images, or a capture folder (then geometry is taken from it)
    #[arg(required_unless_present = "print_config")]
    pub input: Option<PathBuf>,
    /// Folder for everything: scene.safetensors, viewer.html, preview.mp4, run.json, metrics.jsonl, capture/
    #[arg(long, short, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// How long to train.
    #[command(flatten)]
    pub length: LengthArgs,
    /// End in time: training is cut to what is left, and a preview left out; geometry that takes longer is saved (exit code
    /// 75, go on with --resume). Such as 90s, 10m, 1.5h
    #[arg(long, value_name = "TIME", value_parser = values::duration)]
    pub time_limit: Option<f64>,
    /// Which part of the video.
    #[command(flatten)]
    pub video: VideoArgs,
    /// Where to train.
    #[command(flatten)]
    pub device: DeviceArgs,
    /// What to go without.
    #[command(flatten)]
    pub without: WithoutArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// The page.
    #[command(flatten)]
    pub page: PageArgs,
    /// An existing folder.
    #[command(flatten)]
    pub existing: OutArgs,
    /// Make poster.jpg besides, for lists of many clips.
    #[arg(long, hide = true)]
    pub poster: bool,
    /// Which files it may name.
    #[command(flatten)]
    pub reach: ReachArgs,
}
