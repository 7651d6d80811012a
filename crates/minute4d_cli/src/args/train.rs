//! `minute4d train`

use super::{DeviceArgs, LengthArgs, OutArgs, PageArgs, SettingsArgs, WithoutArgs};
use clap::Args;
use std::path::PathBuf;

/// `minute4d train`
#[derive(Debug, Args)]
pub struct Train {
    /// Folder with transforms_train.json, pictures, depth and masks
    #[arg(required_unless_present = "print_config")]
    pub capture: Option<PathBuf>,
    /// Folder for the scene and its records
    #[arg(long, short, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// How long to train.
    #[command(flatten)]
    pub length: LengthArgs,
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
}
