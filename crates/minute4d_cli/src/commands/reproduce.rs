//! `minute4d reproduce`: computes the published tables of a data set.

use super::settings::{job, print_config, settings};
use crate::args::{GeometryArg, OutArgs, Reproduce};
use crate::failure::Failure;
use crate::output::Output;
use minute4d::Error;
use minute4d::device::DeviceRequest;
use minute4d::reproduce::{GeometrySource, ReproduceOptions, TABLE_FILE, reproduce};
use std::path::PathBuf;

pub fn run(args: &Reproduce, output: &Output) -> Result<(), Failure> {
    let mut settings = settings(&args.settings, None, Some(&args.length))?;
    settings.capture.reach = args.reach.reach();
    if args.settings.print_config {
        return print_config(&settings, output);
    }
    let ablations = args.ablations.then(std::env::current_exe).transpose();
    let options = ReproduceOptions {
        geometry: match args.geometry {
            GeometryArg::Given => GeometrySource::Given,
            GeometryArg::Own => GeometrySource::Own,
        },
        ablations: ablations.map_err(|source| Error::Read {
            path: PathBuf::from("the program itself"),
            source,
        })?,
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
    let job = job(device, &existing, settings, output);
    let report = reproduce(args.suite, &args.data, &args.out, &options, &job)?;
    output.note(&format!("tables written to {}", args.out.join(TABLE_FILE).display()));
    output.result(&report.to_markdown(), minute4d::plain_json(&report)?);
    Ok(())
}
