//! A front end of networks from outside, synthetic weights: what is found is worthless, how it is found is not.
#![cfg(feature = "nets")]
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{Ended, Scratch, program};
use m4_testkit::write_formula_weights;
use minute4d::Silent;
use minute4d::io::capture::{self, CaptureOptions, Split};
use minute4d::io::image::write_rgb;
use minute4d::scene::{Capture, Plane};
use serde_json::Value;
use std::fs;
use std::path::Path;

const FRAMES: usize = 24;
/// The least that the tracking network takes.
const SIDE: usize = 128;

/// A clip whose pattern drifts.
fn write_clip(folder: &Path) {
    fs::create_dir(folder).unwrap();
    for k in 0..FRAMES {
        let frame = Plane::from_fn(SIDE, SIDE, |x, y| {
            let (x, y) = (x as f32 + 3.0 * k as f32, y as f32 + k as f32);
            let wave = |a: f32, b: f32| (127.0 + 60.0 * (a * x).sin() + 60.0 * (b * y + 0.03 * x).cos()) as u8;
            [wave(0.21, 0.13), wave(0.09, 0.31), wave(0.37, 0.05)]
        });
        write_rgb(&folder.join(format!("{k:03}.png")), &frame).unwrap();
    }
}

/// Weights under their published names.
fn write_weights(store: &Path) {
    let droid = include_str!("../../../fixtures/droid/keys.txt");
    let raft = include_str!("../../../fixtures/raft/keys.txt");
    for (name, file, keys) in [
        ("megasam", "megasam_final.pth", droid),
        ("raft-things", "raft-things.pth", raft),
    ] {
        fs::create_dir_all(store.join(name)).unwrap();
        write_formula_weights(keys, &store.join(name).join(file));
    }
}

/// Few updates, for the time that they take.
const FEW: [&str; 14] = [
    "megasam.tracking_pixels=16384",
    "megasam.flow_iterations=1",
    "megasam.cvd.stage1.steps=2",
    "megasam.cvd.stage2.steps=3",
    "megasam.tracker.motion_filter_px=0.01",
    "megasam.tracker.keyframe_px=1.1",
    "megasam.tracker.initial_updates=1",
    "megasam.tracker.first_updates=1",
    "megasam.tracker.second_updates=1",
    "megasam.tracker.probe_updates=1",
    "megasam.tracker.backend_updates=1",
    "megasam.tracker.backend_factors=2",
    "megasam.tracker.final_updates=1",
    "megasam.tracker.filler_updates=1",
];

fn run(clip: &Path, out: &Path, store: &Path, more: &[&str]) -> Ended {
    let mut command = program();
    command
        .env("MINUTE4D_WEIGHTS", store)
        .env("HF_HOME", store)
        .arg("geometry")
        .arg(clip)
        .arg("-o")
        .arg(out);
    for setting in FEW {
        command.args(["--set", setting]);
    }
    Ended::of(command.args(more).output().unwrap())
}

fn read(out: &Path) -> Capture {
    capture::read(out, Split::Train, &CaptureOptions::default(), &Silent).unwrap()
}

#[test]
fn megasam_makes_a_capture_and_names_its_networks() {
    let dir = Scratch::new();
    let (clip, store) = (dir.path("clip"), dir.path("weights"));
    write_clip(&clip);
    write_weights(&store);
    let first = dir.path("first");
    let ended = run(&clip, &first, &store, &["--frontend", "megasam"]);
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    // The choice, and the lack of a depth network, is reported.
    assert!(
        ended.stderr.contains("raft") && ended.stderr.contains("no depth from one image"),
        "{}",
        ended.stderr
    );
    let record: Value = serde_json::from_str(&fs::read_to_string(first.join("geometry.json")).unwrap()).unwrap();
    let found = &record["found"];
    assert_eq!(
        (&found["frontend"], &found["frames"]),
        (&Value::from("megasam+raft"), &Value::from(FRAMES))
    );
    let networks = found["networks"].as_array().unwrap();
    let licences: Vec<&str> = networks.iter().map(|n| n["licence"].as_str().unwrap()).collect();
    assert_eq!(licences, ["CC-BY 4.0", "BSD-3-Clause"]);
    assert!(found["keyframes"].as_array().unwrap().len() > 2, "{found}");
    let made = read(&first);
    assert_eq!((made.frames.len(), made.metric), (FRAMES, false));
    assert!(
        made.frames
            .iter()
            .all(|f| f.motion.is_some() && f.mask.is_some() && f.depth.is_some())
    );

    // Another time, on another number of threads: the same bits.
    let second = dir.path("second");
    let ended = run(
        &clip,
        &second,
        &store,
        &["--frontend", "megasam+raft", "--threads", "1"],
    );
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    let again = read(&second);
    for (a, b) in made.frames.iter().zip(&again.frames) {
        assert_eq!(a.camera, b.camera);
        assert_eq!((&a.depth, &a.motion, &a.mask), (&b.depth, &b.motion, &b.mask));
    }
}

#[test]
fn incompatible_or_missing_front_end_parts_are_refused() {
    let dir = Scratch::new();
    let (clip, store, out) = (dir.path("clip"), dir.path("weights"), dir.path("out"));
    write_clip(&clip);
    write_weights(&store);
    for (front_end, code, words) in [
        (
            "megasam+moge",
            66,
            &["moge", "minute4d weights add", "--frontend classical"][..],
        ),
        ("classical+raft", 2, &["classical", "raft", "flow"]),
        ("gmflow", 2, &["gmflow", "raft"]),
        ("megasan", 2, &["megasan", "moge"]),
    ] {
        let ended = run(&clip, &out, &store, &["--frontend", front_end]);
        assert_eq!(ended.code, code, "{front_end}: {}", ended.stderr);
        for word in words {
            assert!(
                ended.stderr.contains(word),
                "{front_end}: {word} is not in {}",
                ended.stderr
            );
        }
    }
    let ended = run(
        &clip,
        &out,
        &store,
        &["--frontend", "megasam", "--segmenter", "mobilesam"],
    );
    assert!(
        ended.code == 66 && ended.stderr.contains("minute4d weights fetch mobile-sam"),
        "{} {}",
        ended.code,
        ended.stderr
    );
}
