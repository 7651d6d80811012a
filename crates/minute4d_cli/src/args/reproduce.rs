//! `minute4d reproduce`

use super::device::device;
use super::{LengthArgs, ReachArgs, SettingsArgs};
use clap::{Args, ValueEnum};
use minute4d::device::DeviceChoice;
use minute4d::evaluate::Protocol;
use minute4d::reproduce::Suite;
use std::path::PathBuf;

/// The source of poses and depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GeometryArg {
    /// Those of the data set.
    Given,
    /// Estimated from the training images alone.
    Own,
}

/// `minute4d reproduce`
#[derive(Debug, Args)]
pub struct Reproduce {
    /// The data set: dycheck, nvidia or davis
    pub suite: Suite,
    /// Folder with the scenes in their published layout
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Folder for the tables (reproduce.md, reproduce.json, one image per scene) and the runs; finished scenes are not run again
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// Evaluation protocols [default: those of the data set: instant4d,dycheck; nvidia; davis]
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    pub protocols: Vec<Protocol>,
    /// Scenes to run [default: those of the published tables]
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    pub scenes: Vec<String>,
    /// Downscaling factor of the images of DyCheck and NVIDIA [default: 2, as in published results]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=8))]
    pub factor: Option<u32>,
    /// Optimise the poses of test images before scoring, where published methods do under the protocol
    #[arg(long)]
    pub refine_poses: bool,
    /// Poses and depth to train with: given (those of the data set) or own (estimated from the training images; views of other cameras are
    /// then placed by alignment) [davis: always own]
    #[arg(long, value_name = "WHOSE", default_value = "given", value_enum)]
    pub geometry: GeometryArg,
    /// Also run every scene without segmentation, without tracking, and without density control
    #[arg(long)]
    pub ablations: bool,
    /// Device for training, rendering and networks: `cpu`, `gpu`, `gpu:N` or `auto`
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = device)]
    pub device: DeviceChoice,
    /// The length of training.
    #[command(flatten)]
    pub length: LengthArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// Which files the data set may refer to.
    #[command(flatten)]
    pub reach: ReachArgs,
}
