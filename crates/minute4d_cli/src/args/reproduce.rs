//! `minute4d reproduce`

use super::device::device;
use super::{LengthArgs, ReachArgs, SettingsArgs};
use clap::{Args, ValueEnum};
use minute4d::device::DeviceChoice;
use minute4d::evaluate::Protocol;
use minute4d::reproduce::Suite;
use std::path::PathBuf;

/// Whose poses and depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum WhoseGeometry {
    /// Those of the data set.
    Given,
    /// From the training pictures alone.
    Own,
}

/// `minute4d reproduce`
#[derive(Debug, Args)]
pub struct Reproduce {
    /// The data set: dycheck, nvidia or davis
    pub suite: Suite,
    /// The folder in which its scenes lie, as they are published
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Folder for the tables (reproduce.md, reproduce.json, a picture each) and the runs; scenes that are finished are not made again
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// Which protocols [default: those of the data set: instant4d,dycheck; nvidia; davis]
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    pub protocols: Vec<Protocol>,
    /// Which scenes [default: those of the published tables]
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    pub scenes: Vec<String>,
    /// By how much the pictures are shrunk, of DyCheck and NVIDIA [default: 2, as published numbers]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=8))]
    pub factor: Option<u32>,
    /// Refine the poses of test pictures against these pictures where the protocol's peers do
    #[arg(long)]
    pub refine_poses: bool,
    /// Whose poses and depth to train with: given (those of the data set) or own (from the training pictures alone; views of other cameras are
    /// then placed by aligning) [davis: always own]
    #[arg(long, value_name = "WHOSE", default_value = "given", value_enum)]
    pub geometry: WhoseGeometry,
    /// Make every scene again without segmentation, tracking and density control each
    #[arg(long)]
    pub ablations: bool,
    /// Where to train and draw, and where networks run: `cpu`, `gpu`, `gpu:N` or `auto`
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = device)]
    pub device: DeviceChoice,
    /// How long to train.
    #[command(flatten)]
    pub length: LengthArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// Which files it may name.
    #[command(flatten)]
    pub reach: ReachArgs,
}
