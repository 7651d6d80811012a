//! `minute4d eval`: a scene against held-out views.

use crate::args::Eval;
use crate::failure::Failure;
use crate::output::Output;

pub fn run(args: &Eval, output: &Output) -> Result<(), Failure> {
    let report = minute4d::evaluate::views(&args.out, &args.data, args.grow_mask, args.device, output)?;
    output.result(&report.images.table(), minute4d::plain_json(&report)?);
    Ok(())
}
