//! `minute4d render`: pictures or a video of a scene.

use crate::args::Render;
use crate::failure::Failure;
use crate::output::Output;
use minute4d::render::{CameraPath, RenderJob, TimePath};
use serde_json::json;

pub fn run(args: &Render, output: &Output) -> Result<(), Failure> {
    let time: TimePath = args.time.parse().map_err(minute4d::Error::from)?;
    let job = RenderJob {
        path: CameraPath::named(&args.path),
        time,
        fps: args.fps,
        replace: args.force,
    };
    let done = minute4d::render::make(&args.scene, &args.out, &job, output)?;
    output.result(
        &args.out.display().to_string(),
        json!({"path": args.out, "frames": done.frames, "seconds": done.seconds}),
    );
    Ok(())
}
