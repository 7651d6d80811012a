//! Clips that geometry cannot make much of: each ends in a capture with a warning, or in a refusal that says what to do.
//! The table of docs/geometry.md says the same.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::clips::{self, FOCAL_PX, SIZE, camera, frame_image};
use crate::common::{Ended, Scratch};
use m4_testkit::{Need, skip};
use minute4d::core::{CounterRng, Plane, RgbImage};
use serde_json::Value;

/// `geometry` of these images.
fn geometry(dir: &Scratch, images: Vec<RgbImage>) -> Ended {
    clips::write(&dir.path("clip"), images);
    dir.succeed("geometry clip -o out --json")
}

/// What is found in these images, and all warnings in one text.
fn found(images: Vec<RgbImage>) -> (Value, String) {
    let ended = geometry(&Scratch::new(), images);
    assert!(!ended.stderr.contains("panicked"), "{}", ended.stderr);
    let record = ended.result()["record"].clone();
    let warnings = record["warnings"].as_array().unwrap().iter();
    let warnings: Vec<&str> = warnings.map(|w| w.as_str().unwrap()).collect();
    (record["found"].clone(), warnings.join("\n"))
}

fn contains(text: &str, words: &[&str]) {
    for word in words {
        assert!(text.contains(word), "{word:?} is not in {text:?}");
    }
}

/// What an honest sensor adds.
fn noisy(image: &RgbImage, frame: u64) -> RgbImage {
    let mut rng = CounterRng::new(5, 0, frame);
    image.map(|rgb| rgb.map(|v| (f64::from(v) + 2.0 * rng.normal()).clamp(0.0, 255.0) as u8))
}

#[test]
fn translating_camera_is_reconstructed() {
    let cameras = clips::walk(24);
    let (found, warnings) = found(cameras.iter().map(frame_image).collect());
    assert_eq!(found["camera_motion"], "parallax", "{found} {warnings}");
    let confidence = &found["confidence"];
    assert!(confidence["parallax_deg"].as_f64().unwrap() > 2.0, "{confidence}");
    assert!(confidence["residual_px"].as_f64().unwrap() < 0.5, "{confidence}");
    assert_eq!(found["frontend"], "classical");
}

#[test]
fn turning_camera_is_reported() {
    let turns = (0..20).map(|i| frame_image(&camera(0.0, 0.02 * f64::from(i) - 0.2, FOCAL_PX)));
    let (found, warnings) = found(turns.collect());
    assert_eq!(found["camera_motion"], "rotation_only", "{found}");
    contains(&warnings, &["the camera rotates", "rotations only", "geometry is poor", "sideways"]);
    assert_eq!(found["confidence"]["grade"], "poor");
}

#[test]
fn a_tripod() {
    let still = frame_image(&camera(0.0, 0.0, FOCAL_PX));
    let (found, warnings) = found((0..12).map(|i| noisy(&still, i)).collect());
    assert_eq!(found["camera_motion"], "static", "{found}");
    contains(&warnings, &["appears to be static", "geometry is poor", "--depth"]);
}

#[test]
fn identical_frames_are_reported_as_static() {
    let still = frame_image(&camera(0.0, 0.0, FOCAL_PX));
    let (found, warnings) = found(vec![still; 8]);
    assert_eq!(found["camera_motion"], "static", "{found}");
    contains(&warnings, &["appears to be static"]);
    assert_eq!(found["moving_share"], 0.0);
}

#[test]
fn zoom_without_translation_is_reported() {
    // The focal length doubles; the camera stays.
    let zoom = (0..16).map(|i| frame_image(&camera(0.0, 0.0, FOCAL_PX * 2.0_f64.powf(f64::from(i) / 15.0))));
    let dir = Scratch::new();
    let record = geometry(&dir, zoom.collect()).result()["record"].clone();
    assert_eq!(record["found"]["camera_motion"], "rotation_only", "{record}");
    assert_eq!(record["found"]["confidence"]["grade"], "poor", "{record}");
    contains(&record["warnings"].to_string(), &["the lens zooms", "without zoom", "geometry is poor"]);
    // Every frame has its own lens.
    let capture = dir.json("out/transforms_train.json");
    let focal = |i: usize| capture["frames"][i]["fl_x"].as_f64().unwrap();
    let ratio = focal(15) / focal(0);
    assert!((ratio / 2.0 - 1.0).abs() < 0.03, "{ratio}");
}

#[test]
fn forward_motion_is_not_a_zoom() {
    let ahead = |i: i32| {
        let mut camera = camera(0.0, 0.0, FOCAL_PX);
        camera.c2w.translation.z = 0.08 * f64::from(i);
        camera
    };
    let (found, warnings) = found((0..16).map(|i| frame_image(&ahead(i))).collect());
    assert_eq!(found["camera_motion"], "parallax", "{found} {warnings}");
    assert!(!warnings.contains("zooms"), "{warnings}");
}

/// A clip that is refused with code 65 and these words, and leaves no capture.
fn refuses(images: Vec<RgbImage>, words: &[&str]) {
    let dir = Scratch::new();
    clips::write(&dir.path("clip"), images);
    dir.refused("geometry clip -o out", 65, words);
    assert!(!dir.path("out/transforms_train.json").exists());
}

#[test]
fn one_frame_a_black_clip_and_a_cut_are_rejected() {
    refuses(vec![frame_image(&camera(0.0, 0.0, FOCAL_PX))], &["at least 2"]);
    let black: RgbImage = Plane::filled(SIZE.0, SIZE.1, [0; 3]);
    refuses(vec![black; 6], &["only 0 points", "--static-camera"]);
    let before = clips::walk(6).iter().map(frame_image).collect::<Vec<_>>();
    let after = (0..6).map(|i| frame_image(&camera(50.0 + 0.1 * f64::from(i), 0.0, FOCAL_PX)));
    refuses(before.into_iter().chain(after).collect(), &["a cut"]);
}

/// 1,500 small frames of a walk there and back: what memory grows by is what docs/geometry.md says. Minutes; run it
/// with `--ignored`, in release.
#[test]
#[ignore = "takes minutes: cargo test --release -p minute4d_cli --test it fifteen_hundred -- --ignored --nocapture"]
fn fifteen_hundred_frames() {
    let images: Vec<RgbImage> = clips::walk(75).iter().map(frame_image).collect();
    let peak = |frames: usize| {
        let there_and_back = (0..frames).map(|i| {
            let k = i % 148;
            images[if k < 75 { k } else { 148 - k }].clone()
        });
        let record = geometry(&Scratch::new(), there_and_back.collect()).result()["record"].clone();
        let bytes = record["peak_memory_bytes"].as_f64();
        eprintln!("{frames} frames: {} s, {:?} bytes", record["seconds"], bytes);
        bytes
    };
    let (Some(few), Some(many)) = (peak(300), peak(1500)) else {
        skip(Need::PeakMemory, "this system does not tell how much memory a process held");
        return;
    };
    // docs/geometry.md has the memory per frame.
    let a_pixel = (many - few) / (1200.0 * (SIZE.0 * SIZE.1) as f64);
    eprintln!("{a_pixel:.0} bytes per pixel and frame");
    assert!(a_pixel < 120.0, "{a_pixel}");
}
