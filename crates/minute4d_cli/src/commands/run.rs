//! `minute4d run`: turns a video into a scene.

use super::settings::{job, print_config, settings};
use super::view::while_training;
use crate::args::Run;
use crate::failure::Failure;
use crate::output::{Output, duration};
use minute4d::Observer;
use minute4d::folder::{PREVIEW_FILE, VIEWER_FILE};
use minute4d::record::RunRecord;
use serde_json::json;
use std::path::Path;

pub fn run(args: &Run, output: &Output) -> Result<(), Failure> {
    let mut settings = settings(&args.settings, Some(&args.video), Some(&args.length))?;
    settings.capture.reach = args.reach.reach();
    args.without.apply(&mut settings);
    settings.viewer.write &= !args.page.no_viewer;
    if let Some(seconds) = args.time_limit {
        settings.limit.time_s = seconds;
    }
    let (Some(input), Some(out), false) = (&args.input, &args.out, args.settings.print_config) else {
        return print_config(&settings, output);
    };
    let device = args.device.request()?;
    let work = |observer: &dyn Observer| {
        let job = job(device, &args.existing, settings, observer);
        let done = minute4d::run(input, out, &job)?;
        if args.poster {
            minute4d::preview::poster(out, input, &job.settings)?;
        }
        Ok(done)
    };
    while_training(&args.page, (input, out), output, work, |done| report(out, done, output))
}

/// Reports the folder of the results, the time, and the file to open.
pub fn report(out: &Path, done: &RunRecord, output: &Output) -> Result<(), Failure> {
    let mut viewable = [VIEWER_FILE, PREVIEW_FILE].into_iter();
    let file = viewable.find(|name| done.files.contains_key(*name));
    let open = file.map_or_else(String::new, |name| format!("; open {}", out.join(name).display()));
    output.note(&format!("finished in {}{open}", duration(done.seconds)));
    output.result(
        &out.display().to_string(),
        json!({"path": out, "record": minute4d::plain_json(done)?}),
    );
    Ok(())
}
