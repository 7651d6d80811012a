//! `minute4d import`: a splat file of another tool as a scene.

use crate::args::Import;
use crate::failure::Failure;
use crate::output::Output;
use minute4d::Existing;

pub fn run(args: &Import, output: &Output) -> Result<(), Failure> {
    let existing = if args.force { Existing::Force } else { Existing::Refuse };
    let report = minute4d::import::make(&args.file, &args.out, args.format, existing, output)?;
    output.note(&format!(
        "{}: {} static and {} dynamic splats, {} frames, {}",
        report.format.name(),
        report.splats_static,
        report.splats_dynamic,
        report.time_frames,
        match report.cameras {
            0 => "no cameras".to_owned(),
            n => format!("{n} cameras"),
        }
    ));
    output.result(&report.path.display().to_string(), minute4d::plain_json(&report)?);
    Ok(())
}
