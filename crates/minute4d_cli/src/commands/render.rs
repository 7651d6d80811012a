//! `minute4d render`: renders images or a video of a scene.

use crate::args::{FitArg, Render};
use crate::failure::Failure;
use crate::output::Output;
use minute4d::render::{CameraPath, Fit, Moment, PathOptions, RenderJob};
use serde_json::json;

pub fn run(args: &Render, output: &Output) -> Result<(), Failure> {
    let usage = minute4d::Error::from;
    let at = args.at.as_deref().map(str::parse::<Moment>).transpose();
    let job = RenderJob {
        options: PathOptions {
            seconds: args.seconds,
            at: at.map_err(usage)?,
            amount: args.amount,
            degrees: args.degrees,
            smooth_s: args.smooth_s,
            strength: args.strength,
            hold_s: args.hold_s,
        },
        time: args.time.parse().map_err(usage)?,
        fps: args.fps,
        size: args.size,
        fit: match args.fit {
            FitArg::Crop => Fit::Crop,
            FitArg::Extend => Fit::Extend,
        },
        zoom: args.zoom,
        replace: args.force,
        device: args.device,
        ..RenderJob::new(CameraPath::named(&args.path))
    };
    let done = minute4d::render::make(&args.scene, &args.out, &job, output)?;
    output.result(
        &args.out.display().to_string(),
        json!({
            "path": args.out,
            "frames": done.frames,
            "fps": done.fps,
            "width": done.size.0,
            "height": done.size.1,
            "seconds": done.seconds,
            "device": done.device,
        }),
    );
    Ok(())
}
