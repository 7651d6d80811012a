//! `minute4d run`: a video to a scene.

use super::settings::{job, print_config, settings};
use crate::args::Run;
use crate::failure::Failure;
use crate::output::{Output, duration};
use serde_json::json;

pub fn run(args: &Run, output: &Output) -> Result<(), Failure> {
    let settings = settings(&args.settings, Some(&args.video), Some(&args.length))?;
    let (Some(input), Some(out), false) = (&args.input, &args.out, args.settings.print_config) else {
        return print_config(&settings, output);
    };
    let job = job(&args.settings, &args.existing, settings, output);
    let done = minute4d::run(input, out, &job)?;
    let preview = out.join(minute4d::folder::PREVIEW_FILE);
    output.note(&format!(
        "{} of work in all; look at {}",
        duration(done.seconds),
        preview.display()
    ));
    output.result(
        &out.display().to_string(),
        json!({"path": out, "record": minute4d::plain_json(&done)?}),
    );
    Ok(())
}
