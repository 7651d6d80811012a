//! `minute4d geometry`: turns a video into a capture.

use super::settings::{job, print_config, settings};
use crate::args::Geometry;
use crate::failure::Failure;
use crate::output::Output;
use minute4d::device::DeviceRequest;
use minute4d::geometry::Segmenter;
use serde_json::json;

pub fn run(args: &Geometry, output: &Output) -> Result<(), Failure> {
    let mut settings = settings(&args.settings, Some(&args.video), None)?;
    args.without.apply(&mut settings);
    let (Some(input), Some(out), false) = (&args.input, &args.out, args.settings.print_config) else {
        return print_config(&settings, output);
    };
    let asked = settings.geometry.segmenter;
    let job = job(
        DeviceRequest {
            choice: args.device,
            max_vram_mb: None,
        },
        &args.existing,
        settings,
        output,
    );
    let record = minute4d::geometry::make(input, out, &job)?;
    if let Some(found) = &record.found {
        output.note(&format!(
            "{} frames, {} x {} pixels, field of view {:.1} degrees, {:.1} % dynamic, reprojection error {:.2} px",
            found.frames,
            found.size[0],
            found.size[1],
            found.fov_deg,
            100.0 * found.moving_share,
            found.residual_px
        ));
        if let Some(confidence) = &found.confidence {
            output.note(&confidence.description());
        }
        if cfg!(feature = "nets")
            && asked == Segmenter::Auto
            && found.segmenter == Segmenter::None.name()
            && found.keyframes.is_none()
        {
            output.note("MobileSAM improves the masks of dynamic objects: `minute4d weights fetch mobile-sam`");
        }
    }
    output.result(
        &out.display().to_string(),
        json!({"path": out, "record": minute4d::plain_json(&record)?}),
    );
    Ok(())
}
