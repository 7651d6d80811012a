//! `minute4d train`: a capture to a scene.

use super::settings::{job, print_config, settings};
use crate::args::Train;
use crate::failure::Failure;
use crate::output::Output;
use serde_json::json;

pub fn run(args: &Train, output: &Output) -> Result<(), Failure> {
    let settings = settings(&args.settings, None, Some(&args.length))?;
    let (Some(capture), Some(out), false) = (&args.capture, &args.out, args.settings.print_config) else {
        return print_config(&settings, output);
    };
    let job = job(&args.settings, &args.existing, settings, output);
    let record = minute4d::train::make(capture, out, &job)?;
    output.result(
        &out.display().to_string(),
        json!({"path": out, "record": minute4d::plain_json(&record)?}),
    );
    Ok(())
}
