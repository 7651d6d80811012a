//! What the program says to bad inputs: each case names its exit code and the words that must be in
//! the message, and `--json` must end with `ok: false`.

use crate::common::{Scratch, edit_transforms, finished_run, write_capture, write_video};
use m4_core::Plane;
use m4_io::image::{write_depth, write_rgb};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

/// `geometry INPUT`, which must be refused.
fn bad_video(dir: &Scratch, input: &str, code: i32, words: &[&str]) {
    dir.refused(&format!("geometry -o never {input}"), code, words);
    assert!(!dir.path("never/transforms_train.json").exists());
}

#[test]
fn damaged_videos_are_rejected() {
    let dir = Scratch::new();
    fs::create_dir(dir.path("empty")).unwrap();
    dir.write("zeros.mp4", [0; 5000]);
    write_video(&dir.path("good.mp4"), 8);
    let bytes = dir.read("good.mp4");
    dir.write("half.mp4", &bytes[..bytes.len() / 2]);
    bad_video(
        &dir,
        "missing.mp4",
        66,
        &["missing.mp4", "there is no video"],
    );
    bad_video(&dir, "empty", 65, &["empty", "no image"]);
    bad_video(&dir, "zeros.mp4", 65, &["zeros.mp4", "not a video"]);
    bad_video(&dir, "half.mp4 --strict-video", 65, &["half.mp4"]);
    bad_video(
        &dir,
        "good.mp4 --start 100",
        65,
        &["good.mp4", "no frame in"],
    );
    bad_video(&dir, "good.mp4 --start 2 --end 1", 78, &["end"]);
    for i in 0..4 {
        write_rgb(
            &dir.path(&format!("flat/{i}.png")),
            &Plane::filled(96, 96, [80; 3]),
        )
        .unwrap();
    }
    bad_video(
        &dir,
        "flat",
        65,
        &["points could be tracked", "--static-camera"],
    );
}

#[test]
fn unknown_and_invalid_settings_are_rejected() {
    let dir = Scratch::new();
    let meant = "did you mean \"train.iterations\"?";
    for (assignment, words) in [
        ("train.iteratons=5", &["train.iteratons", meant][..]),
        ("iterations=5", &[meant]),
        (
            "train.iterations=many",
            &["train.iterations", "\"many\"", "usize"],
        ),
        ("train.iterations=-4", &["train.iterations", "-4"]),
        ("train.density=3", &["train.density = 3"]),
        ("train.iterations", &["key=value"]),
        ("=5", &["key=value"]),
        ("train..seed=5", &["key=value"]),
        ("profile=best", &["profile", "best", "faithful"]),
        ("init.opacity=0.5", &["init.opacity", "max_static"]),
        (
            "train.iterations=5000000000",
            &["train.iterations = 5000000000", "1 to 10000000"],
        ),
        ("train.batch=100000", &["train.batch = 100000", "1 to 32"]),
        ("limit.time_s=nan", &["limit.time_s = NaN"]),
    ] {
        dir.refused(
            &format!("train --print-config --set {assignment}"),
            78,
            words,
        );
    }
    for (file, toml, words) in [
        (
            "syntax.toml",
            "[train\niterations = 5",
            &["not valid TOML", "line 1"][..],
        ),
        (
            "key.toml",
            "[train]\nloss = { lambda = 0.3 }",
            &["train.loss.lambda", "lambda_ssim"],
        ),
        (
            "type.toml",
            "[train.refine]\nposes = 3",
            &["train.refine.poses = 3", "boolean"],
        ),
    ] {
        dir.write(file, toml);
        let words = [&[file][..], words].concat();
        dir.refused(&format!("train --print-config --config {file}"), 78, &words);
    }
    dir.refused(
        "train --print-config --config missing.toml",
        66,
        &["missing.toml"],
    );

    write_capture(&dir.path("capture"), false);
    for (assignment, words) in [
        (
            "train.loss.lambda_ssim=3",
            ["train.loss.lambda_ssim = 3", "0 to 1"],
        ),
        (
            "init.keyframe_gaps=0",
            ["init.keyframe_gaps = 0", "0.001 to"],
        ),
        (
            "train.density.every=2",
            ["train.density.every = 2", "0 to 1"],
        ),
    ] {
        dir.refused(
            &format!("train capture -o never --set {assignment}"),
            78,
            &words,
        );
    }
    assert!(
        !dir.path("never").exists(),
        "nothing is made before the settings are checked"
    );
    let level = [("MINUTE4D_SIMD", "quantum")];
    dir.refused_with(
        "train capture -o never",
        &level,
        69,
        &["quantum", "choose one of"],
    );
}

#[test]
fn conflicting_arguments_are_rejected() {
    let dir = Scratch::new();
    for (line, words) in [
        ("frobnicate", &["frobnicate"][..]),
        ("run a -o b --iterations 0", &["0", "--iterations"]),
        ("run a -o b --profile best", &["best", "--profile"]),
        ("run a -o b --fov 400", &["400", "between 5 and 170"]),
        ("run a -o b --resume --force", &["--resume", "--force"]),
        ("run a", &["--out"]),
        ("train --seed -1", &["-1"]),
    ] {
        dir.refused(line, 2, words);
    }
}

#[test]
fn impossible_outputs_are_rejected() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    dir.write("file", "mine");
    fs::create_dir(dir.path("foreign")).unwrap();
    dir.write("foreign/thesis.txt", "mine");
    let finished = format!("'{}'", finished_run());
    for (out, words) in [
        ("file", &["file", "a file with that name exists"][..]),
        ("file/out", &["file", "cannot write"]),
        ("foreign", &["foreign", "not made by minute4d", "--force"]),
        ("foreign --resume", &["foreign", "not made by minute4d"]),
        (
            finished.as_str(),
            &["a finished run", "--resume", "--force"],
        ),
    ] {
        dir.refused(&format!("train capture --iterations 5 -o {out}"), 73, words);
    }
    assert_eq!(dir.read("foreign/thesis.txt"), b"mine");
    assert_eq!(dir.count("foreign"), 1);
    write_video(&dir.path("clip.mp4"), 3);
    let words = ["not made by minute4d", "geometry.json"];
    dir.refused("geometry clip.mp4 -o capture", 73, &words);
}

#[test]
fn inconsistent_captures_are_rejected() {
    let spoil = |code: i32, words: &[&str], edit: &dyn Fn(&mut Value, &Path)| {
        let dir = Scratch::new();
        write_capture(&dir.path("capture"), false);
        edit_transforms(&dir.path("capture"), |list| {
            edit(list, &dir.path("capture"))
        });
        dir.refused("train capture -o never --iterations 5", code, words);
        assert!(
            !dir.path("never/scene.safetensors").exists(),
            "nothing is made of a bad capture"
        );
    };
    spoil(66, &["frame 3", "gone.png"], &|list, _| {
        list["frames"][3]["file_path"] = json!("train/gone.png")
    });
    spoil(65, &["frame 4", "w = 600", "has 64"], &|list, _| {
        list["frames"][4]["w"] = json!(600)
    });
    spoil(65, &["depth", "geometry"], &|list, _| {
        for frame in list["frames"].as_array_mut().unwrap() {
            frame.as_object_mut().unwrap().remove("depth_file_path");
        }
    });
    spoil(65, &["no usable depth", "unit"], &|list, folder| {
        let none = Plane::filled(64, 48, 0.0f32);
        for i in 0..list["frames"].as_array().unwrap().len() {
            write_depth(&folder.join(format!("depth/{i:05}.png")), &none, 0.001).unwrap();
        }
    });
}

#[test]
fn folders_that_are_not_captures_are_rejected() {
    let dir = Scratch::new();
    fs::create_dir(dir.path("empty")).unwrap();
    dir.refused("train empty -o never", 66, &["transforms_train.json"]);
    dir.refused("train missing -o never", 66, &["no capture at"]);
    assert!(!dir.path("never").exists());
}

#[test]
fn damaged_scenes_are_rejected() {
    let dir = Scratch::new();
    let good = fs::read(Path::new(finished_run()).join("scene.safetensors")).unwrap();
    let mut flipped = good.clone();
    let last = flipped.len() - 5;
    flipped[last] ^= 1;
    dir.write("flipped.safetensors", flipped);
    let damaged = ["flipped.safetensors", "damaged"];
    dir.refused("render flipped.safetensors -o never", 65, &damaged);
    dir.refused("render missing -o never", 66, &["missing"]);
    assert!(!dir.path("never").exists());
}

#[test]
fn eval_without_ground_truth_is_rejected() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let run = finished_run();
    let words = ["transforms_test.json", "held-out"];
    dir.refused(&format!("eval '{run}' --data capture"), 65, &words);
    dir.refused(&format!("eval '{run}' --data missing"), 66, &["missing"]);
    dir.refused("eval no-run --data capture", 66, &["scene.safetensors"]);
}
