//! Output folders that already exist.

use clap::Args;

/// What may happen to an output folder that already exists.
#[derive(Debug, Args)]
pub struct OutArgs {
    /// Continue an earlier run; finished stages are not repeated
    #[arg(long, conflicts_with = "force")]
    pub resume: bool,
    /// Replace the results of an earlier run in the folder; other files are kept
    #[arg(long)]
    pub force: bool,
}
