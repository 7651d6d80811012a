//! Renders a scene along the path of its own cameras with time stopped:
//! `cargo run --release -p minute4d --example render_path -- SCENE OUT.mp4`.

use minute4d::m4_io::video::Mp4Writer;
use minute4d::prelude::*;
use minute4d::render::source_fps;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    run(std::env::args().skip(1))
}

/// What the arguments ask for.
pub fn run(mut args: impl Iterator<Item = String>) -> Result<(), Box<dyn std::error::Error>> {
    let (Some(scene), Some(out)) = (args.next(), args.next()) else {
        return Err("usage: render_path SCENE OUT.mp4".into());
    };
    let scene = Scene::read(scene)?;
    let first = scene.source.first().ok_or("the scene has no cameras")?;
    // the sides of a video are even
    let (width, height) = (
        first.camera.intrinsics.width / 2 * 2,
        first.camera.intrinsics.height / 2 * 2,
    );
    let mut video = Mp4Writer::create(Path::new(&out), width, height, source_fps(&scene))?;
    let middle = (scene.time_frames as f64 - 1.0) / 2.0;
    for source in &scene.source {
        video.push(scene.render(&source.camera.resized(width, height), middle)?)?;
    }
    video.finish()?;
    Ok(())
}
