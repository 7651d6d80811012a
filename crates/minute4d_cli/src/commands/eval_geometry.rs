//! `minute4d eval-geometry`: scores a capture against ground truth.

use crate::args::EvalGeometry;
use crate::failure::Failure;
use crate::output::Output;

pub fn run(args: &EvalGeometry, output: &Output) -> Result<(), Failure> {
    let report = minute4d::evaluate::geometry(&args.capture, &args.truth, args.reach.reach(), output)?;
    let value = minute4d::plain_json(&report)?;
    // Indented, and in the order of the report.
    output.result(&minute4d::pretty_json(&report)?, value);
    Ok(())
}
