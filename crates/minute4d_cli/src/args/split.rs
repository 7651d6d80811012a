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
    /// Whose frames are held out: holdout, instant4d, rodygs or davis
    #[arg(long, value_name = "PROTOCOL")]
    pub protocol: Protocol,
    /// Folder for the capture whose training list lacks the held-out frames and whose test list has them
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// Replace an earlier split in the folder; other files in it stay
    #[arg(long)]
    pub force: bool,
    /// Which files it may name.
    #[command(flatten)]
    pub reach: ReachArgs,
}
