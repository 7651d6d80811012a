//! `minute4d ablate`: the contribution of each part of the method.

use super::settings::{job, print_config, settings};
use crate::args::{Ablate, OutArgs};
use crate::failure::Failure;
use crate::output::Output;
use minute4d::Error;
use minute4d::ablate::{self, AblateOptions, Row};
use minute4d::device::DeviceRequest;
use std::path::PathBuf;

pub fn run(args: &Ablate, output: &Output) -> Result<(), Failure> {
    let mut settings = settings(&args.settings, Some(&args.video), Some(&args.length))?;
    settings.capture.reach = args.reach.reach();
    if args.settings.print_config {
        return print_config(&settings, output);
    }
    let program = std::env::current_exe().map_err(|source| Error::Read {
        path: PathBuf::from("the program itself"),
        source,
    })?;
    let options = AblateOptions {
        program,
        rows: match args.rows.as_slice() {
            [] => Row::ALL.to_vec(),
            rows => rows.to_vec(),
        },
        data: args.data.clone(),
        grow_mask: args.grow_mask,
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
    let report = ablate::ablate(&args.input, &args.out, &options, &job)?;
    if let Some(image) = &report.image {
        output.note(&format!("{}: source, without tracking, full method", image.display()));
    }
    output.result(&report.to_markdown(), minute4d::plain_json(&report)?);
    Ok(())
}
