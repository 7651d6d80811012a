//! `minute4d split`: splits a capture into training and held-out frames.

use crate::failure::Failure;
use crate::options::ReachArgs;
use crate::output::Output;
use clap::Args;
use minute4d::Existing;
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

pub fn run(args: &Split, output: &Output) -> Result<(), Failure> {
    let existing = if args.force { Existing::Force } else { Existing::Refuse };
    let reach = args.reach.reach();
    let record = minute4d::evaluate::split(&args.capture, args.protocol, &args.out, existing, reach, output)?;
    output.note(&format!(
        "{} of {} frames are held out: {}",
        record.held_out.len(),
        record.frames,
        record.frame_rule.description()
    ));
    output.result(&args.out.display().to_string(), minute4d::plain_json(&record)?);
    Ok(())
}
