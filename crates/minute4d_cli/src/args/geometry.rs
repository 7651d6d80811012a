//! `minute4d geometry`

use super::device::device;
use super::{OutArgs, SettingsArgs, VideoArgs, WithoutArgs};
use clap::Args;
use minute4d::device::DeviceChoice;
use std::path::PathBuf;

/// `minute4d geometry`
#[derive(Debug, Args)]
pub struct Geometry {
    /// A video or a folder of images
    #[arg(required_unless_present = "print_config")]
    pub input: Option<PathBuf>,
    /// Folder for the capture
    #[arg(long, short, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// The part of the video.
    #[command(flatten)]
    pub video: VideoArgs,
    /// Device for networks: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or `auto`
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = device)]
    pub device: DeviceChoice,
    /// Parts of the method to switch off.
    #[command(flatten)]
    pub without: WithoutArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// What may happen to an existing folder.
    #[command(flatten)]
    pub existing: OutArgs,
}
