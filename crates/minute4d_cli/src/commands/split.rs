//! `minute4d split`: splits a capture into training and held-out frames.

use crate::args::Split;
use crate::failure::Failure;
use crate::output::Output;
use minute4d::Existing;

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
