//! `minute4d inspect`: describes the contents of a file or folder.

use crate::failure::Failure;
use crate::options::ReachArgs;
use crate::output::Output;
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

pub fn run(args: &Inspect, output: &Output) -> Result<(), Failure> {
    let found = minute4d::inspect::inspect(&args.path, args.reach.reach(), output)?;
    let value = minute4d::plain_json(&found)?;
    output.result(&found.to_string(), value);
    Ok(())
}
