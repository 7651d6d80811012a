//! `minute4d ablate`

use super::device::device;
use super::{LengthArgs, ReachArgs, SettingsArgs, VideoArgs};
use clap::Args;
use minute4d::ablate::Row;
use minute4d::device::DeviceChoice;
use std::path::PathBuf;

/// `minute4d ablate`
#[derive(Debug, Args)]
pub struct Ablate {
    /// A video, a folder of images, or a capture folder (whose geometry is then used)
    pub input: PathBuf,
    /// Folder for the table, with one folder per row in it; finished rows are not computed again
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// The capture whose transforms_test.json lists the held-out views [default: the input]
    #[arg(long, value_name = "CAPTURE")]
    pub data: Option<PathBuf>,
    /// Rows in addition to the full method: no-seg, no-track, no-density [default: all]
    #[arg(long, value_name = "ROW,ROW", value_delimiter = ',')]
    pub rows: Vec<Row>,
    /// Dilate the masks of dynamic regions by this many pixels before scoring
    #[arg(long, value_name = "PX", default_value_t = 0)]
    pub grow_mask: usize,
    /// Device for training and networks: `cpu`, `gpu`, `gpu:N` or `auto`
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = device)]
    pub device: DeviceChoice,
    /// How long to train; every row takes as many steps as the full one.
    #[command(flatten)]
    pub length: LengthArgs,
    /// The part of the video.
    #[command(flatten)]
    pub video: VideoArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// Which files the capture may refer to.
    #[command(flatten)]
    pub reach: ReachArgs,
}
