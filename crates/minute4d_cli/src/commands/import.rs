//! `minute4d import`: turns files of another tool into a scene or a capture.

use crate::args::Import;
use crate::failure::Failure;
use crate::output::Output;
use minute4d::import::{CaptureReport, ImportReport, Report};

pub fn run(args: &Import, output: &Output) -> Result<(), Failure> {
    let report = minute4d::import::make(&args.file, &args.out, &args.job(), output)?;
    match &report {
        Report::Scene(scene) => output.note(&of_scene(scene)),
        Report::Capture(capture) => {
            output.note(&of_capture(capture));
            if let Some(check) = &capture.check {
                output.note(&check.to_string());
            }
        }
    }
    output.result(&args.out.display().to_string(), minute4d::plain_json(&report)?);
    Ok(())
}

fn of_scene(report: &ImportReport) -> String {
    format!(
        "{}: {} static and {} dynamic splats, {} frames, {}",
        report.format.name(),
        report.splats_static,
        report.splats_dynamic,
        report.time_frames,
        match report.cameras {
            0 => "no cameras".to_owned(),
            n => format!("{n} cameras"),
        }
    )
}

fn of_capture(report: &CaptureReport) -> String {
    let [w, h] = report.size;
    format!(
        "{}: {} frames of {w} x {h} pixels, field of view {:.1} degrees, depth of {:.1} % of the pixels, {}{}",
        report.format.name(),
        report.frames,
        report.fov_deg,
        100.0 * report.known_share,
        match report.moving_share {
            None => "no masks".to_owned(),
            Some(share) => format!("{:.1} % dynamic", 100.0 * share),
        },
        match report.held_out {
            0 => String::new(),
            n => format!(", {n} held-out views"),
        }
    )
}
