//! Scores of a capture against the truth.

use crate::common::{Scratch, capture, capture_with_near_objects, write_capture};
use m4_core::Tracks;
use m4_io::capture::{self as files, Split};
use m4_io::tracks;
use minute4d::Silent;
use serde_json::Value;
use std::fs;

#[test]
fn a_capture_is_true_to_itself() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), true);
    let same = dir
        .succeed("eval-geometry capture --truth capture --json")
        .result();
    assert!(
        same["trajectory"]["rmse"].as_f64().unwrap() < 1e-6,
        "{same}"
    );
    let object = &same["objects"][0];
    assert_eq!(
        (&object["distance"], &object["relief"], &object["missed"]),
        (&0.0.into(), &0.0.into(), &0.0.into())
    );
    assert!(
        dir.succeed("eval-geometry capture --truth capture")
            .stdout
            .contains("distance")
    );
}

#[test]
fn files_that_cannot_be_read_are_refused() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), true);
    dir.write("poses.json", "{}");
    for (line, code, words) in [
        (
            "eval-geometry capture --truth missing",
            66,
            &["missing"][..],
        ),
        (
            "eval-geometry capture --truth poses.json",
            65,
            &["poses.json", "lists no frames"],
        ),
    ] {
        dir.refused(line, code, words);
    }
    let list = dir.path("capture/transforms_train.json");
    let text = fs::read_to_string(&list).unwrap();
    fs::rename(dir.path("capture/train"), dir.path("private")).unwrap();
    fs::write(&list, text.replace("\"train/", "\"../private/")).unwrap();
    for line in [
        "eval-geometry capture --truth capture",
        "ablate capture -o made --data capture",
    ] {
        dir.refused(
            line,
            65,
            &["transforms_train.json", "private/", "--allow-outside"],
        );
    }
}

#[cfg(unix)]
#[test]
fn a_pipe_as_truth_is_not_read() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let status = std::process::Command::new("mkfifo")
        .arg(dir.path("pipe.json"))
        .status()
        .unwrap();
    assert!(status.success());
    dir.refused(
        "eval-geometry capture --truth pipe.json",
        65,
        &["pipe.json", "a pipe"],
    );
}

#[test]
fn motion_needs_true_tracks_and_is_compared_with_them() {
    let dir = written(false);
    let frames = capture(6, false).frames.len();
    dir.refused(
        "eval-geometry capture --truth capture --motion",
        66,
        &["true tracks", "tracks.npz"],
    );
    let still = Tracks::new(frames, 1, vec![[0.0, 0.0, 2.0]; frames], vec![true; frames]).unwrap();
    tracks::write(&dir.path("capture/tracks.npz"), &still).unwrap();
    let motion = &dir
        .succeed("eval-geometry capture --truth capture --motion --json")
        .result()["motion"];
    let after: Vec<&Value> = motion["carried"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| &row["after"])
        .collect();
    assert!(
        after == [&5.0, &10.0] && motion["lives"]["count"].is_u64(),
        "{motion}"
    );
    let table = dir
        .succeed("eval-geometry capture --truth capture --motion")
        .stdout;
    assert!(
        table.contains("standard deviation") && table.contains("lives that end"),
        "{table}"
    );
}

/// The capture with half the dynamic depth: `eval` has its baselines, and `--explain` names the
/// cause, by warping and by training.
#[test]
fn explanation_names_the_wrong_part_and_baselines_need_no_training() {
    let dir = written(true);
    let own = capture_with_near_objects();
    files::write(&dir.path("own"), &own, Split::Train, &Silent).unwrap();
    let explained = dir
        .succeed("eval-geometry own --truth capture --explain --train 40 -o work --json")
        .result();
    let row = |what: &str, how: &str| {
        let rows = explained["explain"].as_array().unwrap();
        let row = rows
            .iter()
            .find(|r| r["what"] == what && r["set"] == "far")
            .unwrap();
        row[how]["masked_psnr_db"].as_f64().unwrap()
    };
    for how in ["warped", "trained"] {
        let [none, fixed, distance, all] =
            ["none", "static_depth", "distance", "all"].map(|what| row(what, how));
        assert!(
            distance > none + 1.0 && (fixed - none).abs() < 0.5 && (all - distance).abs() < 1.0,
            "{how}: {explained}"
        );
    }
}

fn written(held_out: bool) -> Scratch {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), held_out);
    dir
}
