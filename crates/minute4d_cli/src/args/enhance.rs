//! `minute4d enhance`

use super::device::device;
use super::{OutArgs, ReachArgs, Segmenter, SettingsArgs, Tracker};
use clap::Args;
use minute4d::device::DeviceChoice;
use std::path::PathBuf;

/// `minute4d enhance`
#[derive(Debug, Args)]
pub struct Enhance {
    /// A capture with motion maps or masks of dynamic regions
    #[arg(required_unless_present = "print_config")]
    pub capture: Option<PathBuf>,
    /// Folder for the enhanced capture
    #[arg(long, short, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// Segmentation method [default: auto]
    #[arg(long, value_enum)]
    pub segmenter: Option<Segmenter>,
    /// Tracking method [default: auto]
    #[arg(long, value_enum)]
    pub tracker: Option<Tracker>,
    /// Device for networks: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or `auto`
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = device)]
    pub device: DeviceChoice,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// What may happen to an existing folder.
    #[command(flatten)]
    pub existing: OutArgs,
    /// Which files the capture may refer to.
    #[command(flatten)]
    pub reach: ReachArgs,
}
