//! `minute4d inspect`: describes the contents of a file or folder.

use crate::args::Inspect;
use crate::failure::Failure;
use crate::output::Output;

pub fn run(args: &Inspect, output: &Output) -> Result<(), Failure> {
    let found = minute4d::inspect::inspect(&args.path, args.reach.reach(), output)?;
    let value = minute4d::plain_json(&found)?;
    output.result(&found.to_string(), value);
    Ok(())
}
