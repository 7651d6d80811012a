//! `minute4d enhance`: improves the masks of a capture and tracks points.

use super::settings::{job, print_config, settings};
use crate::args::Enhance;
use crate::failure::Failure;
use crate::output::Output;
use minute4d::device::DeviceRequest;
use serde_json::json;

pub fn run(args: &Enhance, output: &Output) -> Result<(), Failure> {
    let mut settings = settings(&args.settings, None, None)?;
    settings.capture.reach = args.reach.reach();
    let geometry = &mut settings.geometry;
    geometry.segmenter = args.segmenter.map_or(geometry.segmenter, Into::into);
    geometry.tracker = args.tracker.map_or(geometry.tracker, Into::into);
    let (Some(capture), Some(out), false) = (&args.capture, &args.out, args.settings.print_config) else {
        return print_config(&settings, output);
    };
    let device = DeviceRequest {
        choice: args.device,
        max_vram_mb: None,
    };
    let job = job(device, &args.existing, settings, output);
    let report = minute4d::enhance::make(capture, out, &job)?;
    let share = |share: Option<f64>| share.map_or_else(|| "unknown".to_owned(), |s| format!("{:.1} %", 100.0 * s));
    output.note(&format!(
        "segmentation {}: {} objects; dynamic pixels {} before, {} now; tracking {}: {} points",
        report.segmenter,
        report.instances,
        share(report.moving_share[0]),
        share(report.moving_share[1]),
        report.tracker,
        report.tracks
    ));
    output.result(
        &out.display().to_string(),
        json!({"path": out, "record": minute4d::plain_json(&report)?}),
    );
    Ok(())
}
