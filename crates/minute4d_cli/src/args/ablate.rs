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
    /// A video, a folder of images, or a capture folder (then geometry is taken from it)
    pub input: PathBuf,
    /// Folder for the table, and a folder in it for every row; rows that are finished are not made again
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// The capture whose transforms_test.json lists the held-out views [default: the input]
    #[arg(long, value_name = "CAPTURE")]
    pub data: Option<PathBuf>,
    /// Which rows beside the full one: no-seg, no-track, no-density [default: all]
    #[arg(long, value_name = "ROW,ROW", value_delimiter = ',')]
    pub rows: Vec<Row>,
    /// Grow the masks of moving parts by this much before they are scored, pixels
    #[arg(long, value_name = "PX", default_value_t = 0)]
    pub grow_mask: usize,
    /// Where to train, and where networks run: `cpu`, `gpu`, `gpu:N` or `auto`
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = device)]
    pub device: DeviceChoice,
    /// How long to train: the full row's number of steps is that of all.
    #[command(flatten)]
    pub length: LengthArgs,
    /// Which part of the video.
    #[command(flatten)]
    pub video: VideoArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// Which files it may name.
    #[command(flatten)]
    pub reach: ReachArgs,
}
