//! `minute4d inspect`

use super::ReachArgs;
use clap::Args;
use std::path::PathBuf;

/// `minute4d inspect`
#[derive(Debug, Args)]
pub struct Inspect {
    /// A video, a capture folder, a scene file or the folder of a run
    pub path: PathBuf,
    /// Which files a capture may refer to.
    #[command(flatten)]
    pub reach: ReachArgs,
}
