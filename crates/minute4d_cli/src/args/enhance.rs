//! `minute4d enhance`

use super::device::device;
use super::{OutArgs, ReachArgs, Segmenter, SettingsArgs, Tracker};
use clap::Args;
use minute4d::device::DeviceChoice;
use std::path::PathBuf;

/// `minute4d enhance`
#[derive(Debug, Args)]
pub struct Enhance {
    /// A capture that says what moves, by maps of motion or masks
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
    /// Where networks run: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or `auto`
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = device)]
    pub device: DeviceChoice,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// An existing folder.
    #[command(flatten)]
    pub existing: OutArgs,
    /// Which files it may name.
    #[command(flatten)]
    pub reach: ReachArgs,
}
