//! Reconstructs a video, trains a scene and renders it from a camera beside the path, and writes
//! its page: `cargo run --release -p minute4d --example video_to_frames -- CLIP FOLDER [SECONDS]`.

#![expect(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program for a terminal"
)]

use minute4d::Event;
use minute4d::m4_io::image::write_rgb;
use minute4d::prelude::*;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    run(std::env::args().skip(1))
}

/// What the arguments ask for.
pub fn run(mut args: impl Iterator<Item = String>) -> Result<(), Box<dyn std::error::Error>> {
    let (Some(clip), Some(folder)) = (args.next(), args.next().map(PathBuf::from)) else {
        return Err("usage: video_to_frames CLIP FOLDER [SECONDS]".into());
    };
    let seconds = args.next().map_or(Ok(20.0), |text| text.parse())?;
    let options = Options::new().seconds(seconds).on_event(|event| {
        if let Event::Warning(message) = event {
            eprintln!("warning: {message}");
        }
    });
    let reconstruction = reconstruct(&Video::open(clip)?, &options)?;
    println!(
        "{} frames, {:.1} degrees of view",
        reconstruction.summary.frames, reconstruction.summary.fov_deg
    );
    let scene = train(&reconstruction.capture, &options)?;
    std::fs::create_dir_all(&folder)?;
    for (i, frame) in reconstruction.capture.frames.iter().enumerate() {
        let mut camera = frame.camera;
        // a step to the right of where the video was taken, in units of the scene
        camera.c2w.translation += camera.c2w.rotation.column(0) * 0.05;
        write_rgb(
            &folder.join(format!("{i:05}.png")),
            &scene.render(&camera, frame.t)?,
        )?;
    }
    scene.write(folder.join("scene.safetensors"))?;
    scene.write_page(
        folder.join("viewer.html"),
        "example",
        &reconstruction.capture,
    )?;
    Ok(())
}
