//! Clips as people have them: with cuts, black, repeated and frozen frames, bars, logos and
//! flicker. Each is named, and gives the cameras of the walk that it shows (docs/geometry.md has
//! the table).

use crate::common::clips::{self, FOCAL_PX, SIZE, camera, frame_image, walk};
use crate::common::{Scratch, read_capture};
use crate::geometry::camera_errors;
use m4_core::{Camera, Capture, Plane, RgbImage};
use m4_io::capture::Split;
use serde_json::{Value, json};

/// 30 frames per second, as folders are read.
const FPS: f64 = 30.0;

const GEOMETRY: &str = "geometry clip -o out --force";

/// What geometry says of a clip, its warnings, and the capture.
fn geometry(dir: &Scratch, options: &str) -> (Value, String, Capture) {
    let ended = dir.succeed(&format!("{GEOMETRY} --json {options}"));
    let record = ended.result()["record"].clone();
    let warnings = record["warnings"].as_array().unwrap().iter();
    let warnings: Vec<&str> = warnings.map(|w| w.as_str().unwrap()).collect();
    let capture = read_capture(&dir.path("out"), Split::Train);
    (record["found"].clone(), warnings.join("\n"), capture)
}

fn of(images: Vec<RgbImage>, options: &str) -> (Value, String, Capture) {
    let dir = Scratch::new();
    clips::write(&dir.path("clip"), images);
    geometry(&dir, options)
}

fn contains(text: &str, words: &[&str]) {
    for word in words {
        assert!(text.contains(word), "{word:?} is not in {text:?}");
    }
}

/// The cameras are those of the walk.
fn reconstructed(capture: &Capture, truth: &[Camera]) {
    let errors = camera_errors(capture, truth);
    assert!(
        errors[0] < 1.0 && errors[1] < 0.5 && errors[2] < 6.0,
        "{errors:?}"
    );
}

fn images(cameras: &[Camera]) -> Vec<RgbImage> {
    cameras.iter().map(frame_image).collect()
}

/// A camera that moves to the right, and does not turn.
fn sideways(n: usize, from: f64) -> Vec<Camera> {
    let mut cameras = vec![camera(0.0, 0.0, FOCAL_PX); n];
    for (i, camera) in cameras.iter_mut().enumerate() {
        camera.c2w.translation.x = from + 0.03 * i as f64;
    }
    cameras
}

fn lit(image: &RgbImage, factor: f64) -> RgbImage {
    image.map(|rgb| rgb.map(|v| (f64::from(v) * factor).clamp(0.0, 255.0) as u8))
}

#[test]
fn one_take_says_nothing_of_footage() {
    let (summary, warnings, capture) = of(images(&walk(24)), "");
    assert_eq!(summary["footage"], Value::Null, "{warnings}");
    assert!(
        !warnings.contains("left out") && !warnings.contains("shot"),
        "{warnings}"
    );
    assert_eq!(capture.frames.len(), 24);
}

#[test]
fn cameras_of_a_long_clip_use_more_frames_than_are_kept() {
    let truth = walk(320);
    let (_, warnings, capture) = of(images(&truth), "--max-frames 8");
    contains(&warnings, &["320 frames", "29", m4_core::advice::FRAMES]);
    // 29 frames have depth, 8 of them are kept
    let kept: Vec<Camera> = m4_core::evenly(320, Some(29))
        .into_iter()
        .step_by(4)
        .map(|i| truth[i])
        .collect();
    reconstructed(&capture, &kept);
    assert_eq!(capture.frames[7].rgb, frame_image(&truth[319]));
}

#[test]
fn of_a_clip_with_cuts_the_longest_shot_is_used_or_the_one_asked_for() {
    let dir = Scratch::new();
    let (first, second) = (sideways(20, 20.0), walk(40));
    let mut all = images(&first);
    all.extend(images(&second));
    clips::write(&dir.path("clip"), all);
    let (summary, warnings, capture) = geometry(&dir, "");
    let spans = json!([[0.0, 19.0 / FPS], [20.0 / FPS, 59.0 / FPS]]);
    assert_eq!(summary["footage"]["shots"], spans, "{summary}");
    assert_eq!(
        (&summary["footage"]["shot"], capture.frames.len()),
        (&json!(2), 40)
    );
    contains(
        &warnings,
        &[
            "2 shots",
            "1: 0.00 s to 0.63 s, 2: 0.67 s to 1.97 s",
            "shot 2 is used",
            m4_core::advice::SHOT,
        ],
    );
    reconstructed(&capture, &second);
    // The clip is thinned after its shots are known.
    let (summary, _, capture) = geometry(&dir, "--max-frames 6");
    assert_eq!(
        (&summary["footage"]["shot"], capture.frames.len()),
        (&json!(2), 6)
    );
    let ends = [&capture.frames[0].rgb, &capture.frames[5].rgb];
    assert_eq!(ends, [&frame_image(&second[0]), &frame_image(&second[39])]);
    let (summary, warnings, capture) = geometry(&dir, "--shot 1");
    assert_eq!(
        (&summary["footage"]["shot"], capture.frames.len()),
        (&json!(1), 20)
    );
    contains(&warnings, &["shot 1 is used"]);
    assert_eq!(capture.frames[0].rgb, frame_image(&first[0]));
    let words = ["shot 3", "has 2", "0.67 s to 1.97 s"];
    dir.refused(&format!("{GEOMETRY} --shot 3"), 65, &words);
    dir.refused(&format!("{GEOMETRY} --shot 0"), 2, &["--shot"]);
}

#[test]
fn a_shot_that_is_not_there_is_refused() {
    let dir = Scratch::new();
    clips::write(&dir.path("clip"), images(&walk(12)));
    dir.refused(&format!("{GEOMETRY} --shot 2"), 65, &["shot 2", "one shot"]);
    clips::write(
        &dir.path("masks"),
        vec![Plane::filled(SIZE.0, SIZE.1, [0; 3]); 12],
    );
    let line = format!("{GEOMETRY} --shot 1 --masks masks");
    dir.refused(&line, 2, &["a shot cannot be chosen", "masks"]);
}

#[test]
fn black_frames_fades_and_a_covered_lens_are_left_out() {
    let cameras = walk(40);
    let mut clip = images(&cameras);
    for (i, image) in clip.iter_mut().enumerate() {
        match i {
            0..6 => *image = lit(image, i as f64 / 6.0),
            18..21 => *image = Plane::filled(SIZE.0, SIZE.1, [0; 3]),
            28..32 => *image = Plane::from_fn(SIZE.0, SIZE.1, |x, _| [80 + (x / 4) as u8, 25, 14]),
            _ => {}
        }
    }
    let (summary, warnings, capture) = of(clip, "");
    let blank = summary["footage"]["blank_frames"].as_u64().unwrap() as usize;
    assert!((10..=13).contains(&blank), "{summary}");
    contains(
        &warnings,
        &[
            "show nothing",
            "0.60 s to 0.67 s",
            "0.93 s to 1.03 s",
            "left out",
        ],
    );
    let first = blank - 7;
    let kept: Vec<Camera> = (first..40)
        .filter(|i| !(18..21).contains(i) && !(28..32).contains(i))
        .map(|i| cameras[i])
        .collect();
    reconstructed(&capture, &kept);
}

#[test]
fn repeated_frames_are_dropped_and_times_kept_true() {
    let cameras = walk(24);
    let shown = (0..60)
        .map(|i| frame_image(&cameras[i * 24 / 60]))
        .collect();
    let (summary, warnings, capture) = of(shown, "--set video.folder_fps=60");
    assert_eq!(summary["footage"]["repeated_frames"], 36, "{summary}");
    contains(&warnings, &["36 of 60 frames repeat", "left out"]);
    for (i, frame) in capture.frames.iter().enumerate() {
        assert!((frame.t - i as f64).abs() < 0.03, "{i}: {}", frame.t);
    }
    let seconds = capture.duration_s.unwrap();
    assert!((seconds - 23.0 / 24.0).abs() < 0.02, "{seconds}");
    reconstructed(&capture, &cameras);
}

#[test]
fn a_frozen_image_is_named() {
    let cameras = walk(30);
    let mut clip = images(&cameras);
    let still = clip[29].clone();
    clip.extend(vec![still; 20]);
    let (summary, warnings, capture) = of(clip, "");
    assert_eq!(
        summary["footage"]["frozen_s"].as_array().unwrap().len(),
        1,
        "{summary}"
    );
    contains(&warnings, &["frozen from 0.97 s to 1.63 s"]);
    assert_eq!(capture.frames.len(), 50);
}

#[test]
fn bars_are_cut_off_and_the_lens_stays() {
    let cameras = walk(24);
    let barred = |shade: u8| {
        images(&cameras).into_iter().map(move |image| {
            Plane::from_fn(SIZE.0, SIZE.1, |x, y| match y {
                16..104 => image[(x, y)],
                _ => [shade; 3],
            })
        })
    };
    let (summary, warnings, capture) = of(barred(0).collect(), "");
    assert_eq!(summary["footage"]["crop"], json!([0, 16, 160, 88]));
    contains(&warnings, &["top 16, bottom 16", "160 x 88"]);
    assert_eq!(capture.frames[0].rgb.size(), (160, 88));
    reconstructed(&capture, &cameras);
    // A lens that was measured belongs to the frames of the file.
    let lens = format!("--intrinsics {FOCAL_PX},{FOCAL_PX},80,58");
    let (_, _, capture) = of(barred(16).collect(), &lens);
    let k = capture.frames[0].camera.intrinsics;
    assert_eq!((k.fx, k.cx, k.cy), (FOCAL_PX, 80.0, 42.0));
}

/// Strokes with a dark rim.
fn letters(image: &mut RgbImage, (x, y): (usize, usize), n: usize) {
    for k in 0..n {
        for row in 0..10 {
            for column in 0..6 {
                let stroke = match k % 3 {
                    0 => column % 4 < 2,
                    1 => row % 5 < 2 || column < 2,
                    _ => (row + 2 * column) % 6 < 3,
                };
                image[(x + 7 * k + column, y + row)] = if stroke { [245; 3] } else { [15; 3] };
            }
        }
    }
}

#[test]
fn logos_and_subtitles_do_not_hold_the_cameras_back() {
    let cameras = sideways(60, -0.9);
    let mut clip = images(&cameras);
    for (i, image) in clip.iter_mut().enumerate() {
        letters(image, (124, 8), 4);
        if i >= 25 {
            letters(image, (30, 100), 12);
        }
    }
    let (summary, warnings, capture) = of(clip, "--fov 56.14");
    assert_eq!(summary["footage"]["overlay_frames"], 60, "{summary}");
    contains(
        &warnings,
        &[
            "a logo, subtitles or other marks",
            "60 of 60 frames",
            "removed",
        ],
    );
    reconstructed(&capture, &cameras);
    // White strokes are gone.
    let whites = |image: &RgbImage| image.data().iter().filter(|rgb| rgb[2] > 240).count();
    assert!(whites(&capture.frames[30].rgb) <= whites(&frame_image(&cameras[30])) + 20);
}

#[test]
fn flicker_is_evened_out_and_a_change_of_exposure_is_named() {
    let cameras = walk(30);
    let factor = |i: usize| 0.85 + 0.09 * (2.3 * i as f64).sin();
    let lamp = images(&cameras)
        .iter()
        .enumerate()
        .map(|(i, image)| lit(image, factor(i)))
        .collect();
    let (summary, warnings, capture) = of(lamp, "");
    assert!(
        summary["footage"]["flicker_percent"].as_f64().unwrap() > 4.0,
        "{summary}"
    );
    contains(&warnings, &["flickers"]);
    reconstructed(&capture, &cameras);
    let fall = |i: usize| 1.0 - 0.5 * (i as f64 / 29.0);
    let falling = images(&cameras)
        .iter()
        .enumerate()
        .map(|(i, image)| lit(image, fall(i)))
        .collect();
    let (summary, warnings, capture) = of(falling, "");
    assert!(
        summary["footage"]["exposure_percent"].as_f64().unwrap() > 35.0,
        "{summary}"
    );
    contains(
        &warnings,
        &["the exposure changes", "train.refine.exposure"],
    );
    assert_eq!(capture.frames.len(), 30);
}
