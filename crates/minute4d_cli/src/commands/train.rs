//! `minute4d train`: trains a scene from a capture.

use super::run::report;
use super::settings::{job, print_config, settings};
use super::view::while_training;
use crate::args::Train;
use crate::failure::Failure;
use crate::output::Output;
use minute4d::Observer;

pub fn run(args: &Train, output: &Output) -> Result<(), Failure> {
    let mut settings = settings(&args.settings, None, Some(&args.length))?;
    settings.capture.reach = args.reach.reach();
    args.without.apply(&mut settings);
    settings.viewer.write &= !args.page.no_viewer;
    if let Some(seconds) = args.time_limit {
        settings.limit.time_s = seconds;
    }
    let (Some(capture), Some(out), false) = (&args.capture, &args.out, args.settings.print_config) else {
        return print_config(&settings, output);
    };
    let device = args.device.request()?;
    let work = |observer: &dyn Observer| {
        let job = job(device, &args.existing, settings, observer);
        minute4d::train::make(capture, out, &job)
    };
    while_training(&args.page, (capture, out), output, work, |done| {
        report(out, done, output)
    })
}
