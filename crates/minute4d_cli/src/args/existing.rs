//! Folders that are already there.

use clap::Args;

/// What may happen to a folder that is already there.
#[derive(Debug, Args)]
pub struct OutArgs {
    /// Go on where an earlier run stopped; finished stages are not repeated
    #[arg(long, conflicts_with = "force")]
    pub resume: bool,
    /// Replace what an earlier run left in the folder; other files in it stay
    #[arg(long)]
    pub force: bool,
}
