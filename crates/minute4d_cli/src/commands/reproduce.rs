//! `minute4d reproduce`: the tables of papers, from the data sets themselves.

use super::settings::{job, print_config, settings};
use crate::args::{OutArgs, Reproduce};
use crate::failure::Failure;
use crate::output::Output;
use minute4d::device::DeviceRequest;
use minute4d::reproduce::{ReproduceOptions, TABLE_FILE, reproduce};

pub fn run(args: &Reproduce, output: &Output) -> Result<(), Failure> {
    let settings = settings(&args.settings, None, Some(&args.length))?;
    if args.settings.print_config {
        return print_config(&settings, output);
    }
    let options = ReproduceOptions {
        protocols: args.protocols.clone(),
        scenes: args.scenes.clone(),
        factor: args.factor,
        refine_poses: args.refine_poses,
    };
    let device = DeviceRequest {
        choice: args.device,
        max_vram_mb: None,
    };
    let existing = OutArgs {
        resume: true,
        force: false,
    };
    let job = job(&args.settings, device, &existing, settings, output);
    let report = reproduce(args.suite, &args.data, &args.out, &options, &job)?;
    output.note(&format!("{}: the tables", args.out.join(TABLE_FILE).display()));
    output.result(&report.to_markdown(), minute4d::plain_json(&report)?);
    Ok(())
}
