//! `minute4d train`

use super::{DeviceArgs, LengthArgs, OutArgs, PageArgs, ReachArgs, SettingsArgs, WithoutArgs, values};
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
    /// End in time: training is cut to what is left, and a preview left out; geometry that takes longer is saved (exit code
    /// 75, go on with --resume). Such as 90s, 10m, 1.5h
    #[arg(long, value_name = "TIME", value_parser = values::duration)]
    pub time_limit: Option<f64>,
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
    /// Which files it may name.
    #[command(flatten)]
    pub reach: ReachArgs,
}
