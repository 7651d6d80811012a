//! Writes the page of a scene: `cargo run --release -p m4_viewer --example page -- SCENE.safetensors OUT.html [CAPTURE]`.

use m4_io::capture::{self, CaptureOptions, Split};
use m4_io::{atomic, scene_file};
use m4_scene::{Camera, Column, RgbImage, Scene, Silent};
use m4_viewer::page::{self, Effort, Parts, TEMPLATE};
use m4_viewer::payload::{PayloadConfig, encode};
use m4_viewer::{About, FrameLimits, Manifest, encode_frames};
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [scene, out, rest @ ..] = args.as_slice() else {
        return Err("give a scene file, a name for the page and, where there is one, a capture".into());
    };
    let scene_path = Path::new(scene);
    let scene = scene_file::read(scene_path)?.scene;
    let median_depth = median_depth(&scene);
    let payload = encode(&scene, median_depth, &PayloadConfig::default());
    let seconds = scene.duration_s.filter(|s| *s > 0.0);
    let about = About {
        title: scene_path
            .parent()
            .and_then(|p| p.file_name()?.to_str())
            .unwrap_or("scene"),
        median_depth,
        fps: seconds.map_or(30.0, |s| scene.time_frames.saturating_sub(1) as f64 / s),
    };
    let mut manifest = Manifest::new(&scene, &payload, &about);
    let frames = match rest.first() {
        Some(folder) => {
            let capture = capture::read(Path::new(folder), Split::Train, &CaptureOptions::default(), &Silent)?;
            let pictures: Vec<&RgbImage> = capture.frames.iter().map(|f| &f.rgb).collect();
            encode_frames(&pictures, &FrameLimits::default())?
        }
        None => None,
    };
    manifest.frames = frames.as_ref().map(|f| f.index.clone());
    let parts = Parts {
        manifest: &manifest,
        payload: Some(&payload.bytes),
        frames: frames.as_ref(),
    };
    atomic::write(Path::new(out), &page::compose(TEMPLATE, &parts, Effort::Small)?)?;
    Ok(())
}

/// Median z-depth of the splats before the middle camera: near enough to what it sees, without a renderer.
fn median_depth(scene: &Scene) -> f64 {
    let Some(camera) = scene.source.get(scene.source.len() / 2).map(|s| s.camera) else {
        return 1.0;
    };
    let mut depths: Vec<f64> = (0..scene.splats.n())
        .filter_map(|row| in_view(scene, &camera, row))
        .collect();
    let middle = depths.len() / 2;
    if depths.is_empty() {
        1.0
    } else {
        *depths.select_nth_unstable_by(middle, f64::total_cmp).1
    }
}

fn in_view(scene: &Scene, camera: &Camera, row: usize) -> Option<f64> {
    let mean: [f64; 3] = std::array::from_fn(|k| f64::from(scene.splats.column(Column::Mean, k)[row]));
    let ([u, v], z) = camera.project(&mean.into());
    let k = &camera.intrinsics;
    (z > 0.0 && (0.0..k.width as f64).contains(&u) && (0.0..k.height as f64).contains(&v)).then_some(z)
}
