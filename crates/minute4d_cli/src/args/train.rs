//! `minute4d train`

use super::{DeviceArgs, LengthArgs, OutArgs, PageArgs, ReachArgs, SettingsArgs, WithoutArgs, values};
use clap::Args;
use std::path::PathBuf;

/// `minute4d train`
#[derive(Debug, Args)]
pub struct Train {
    /// A capture: a folder with transforms_train.json, images, depth and masks
    #[arg(required_unless_present = "print_config")]
    pub capture: Option<PathBuf>,
    /// Folder for the scene and its records
    #[arg(long, short, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// The length of training.
    #[command(flatten)]
    pub length: LengthArgs,
    /// Time limit, such as 90s, 10m or 1.5h: training is shortened to the time left and the preview may be skipped
    #[arg(long, value_name = "TIME", value_parser = values::duration)]
    pub time_limit: Option<f64>,
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
    /// Which files the capture may refer to.
    #[command(flatten)]
    pub reach: ReachArgs,
}
