//! `minute4d split`

use super::ReachArgs;
use clap::Args;
use minute4d::evaluate::Protocol;
use std::path::PathBuf;

/// `minute4d split`
#[derive(Debug, Args)]
pub struct Split {
    /// A capture of the whole video: folder with transforms_train.json
    pub capture: PathBuf,
    /// Protocol that chooses the held-out frames: holdout, instant4d, rodygs or davis
    #[arg(long, value_name = "PROTOCOL")]
    pub protocol: Protocol,
    /// Folder for the new capture, with the held-out frames in its test list only
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// Replace an earlier split in the folder; other files are kept
    #[arg(long)]
    pub force: bool,
    /// Which files the capture may refer to.
    #[command(flatten)]
    pub reach: ReachArgs,
}
