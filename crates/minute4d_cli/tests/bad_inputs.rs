//! What the program says to bad inputs: each case names its exit code and the words that must be in
//! the message, and `--json` must end with `ok: false`.

use crate::common::{Scratch, edit_transforms, finished_run, write_capture, write_images, write_video};
use m4_testkit::{Need, skip};
use minute4d::core::Plane;
use minute4d::io::image::{write_depth, write_rgb};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use std::process::Command;

/// `geometry INPUT`, which must be refused.
fn bad_video(dir: &Scratch, input: &str, code: i32, words: &[&str]) {
    dir.refused(&format!("geometry -o never {input}"), code, words);
    assert!(!dir.path("never/transforms_train.json").exists());
}

#[test]
fn files_that_are_not_videos_are_rejected() {
    let dir = Scratch::new();
    fs::create_dir(dir.path("empty")).unwrap();
    dir.write("zero.mp4", b"");
    dir.write("zeros.mp4", [0; 5000]);
    bad_video(&dir, "missing.mp4", 66, &["missing.mp4", "there is no video"]);
    bad_video(&dir, "empty", 65, &["empty", "no image"]);
    bad_video(&dir, "zero.mp4", 65, &["zero.mp4", "empty (0 bytes)"]);
    bad_video(&dir, "zeros.mp4", 65, &["zeros.mp4", "not a video"]);
}

#[test]
fn damaged_videos_are_rejected() {
    let dir = Scratch::new();
    write_video(&dir.path("good.mp4"), 8);
    let bytes = dir.read("good.mp4");
    // Within the index: nothing can be found. Within the images: some are missing.
    dir.write("index.mp4", &bytes[..200]);
    dir.write("half.mp4", &bytes[..bytes.len() / 2]);
    bad_video(&dir, "index.mp4", 65, &["index.mp4", "incomplete"]);
    bad_video(&dir, "half.mp4 --strict-video", 65, &["half.mp4"]);
    bad_video(&dir, "good.mp4 --start 100", 65, &["good.mp4", "no frame in"]);
    bad_video(&dir, "good.mp4 --start 2 --end 1", 78, &["end"]);
}

#[test]
fn codec_without_a_decoder_names_ffmpeg() {
    let dir = Scratch::new();
    write_video(&dir.path("good.mp4"), 8);
    let mut bytes = dir.read("good.mp4");
    // The brand at the front may have the same name; the last one is that of the track.
    let at = bytes.windows(4).rposition(|w| w == b"avc1");
    let at = at.expect("the codec is named in the index");
    bytes[at..at + 4].copy_from_slice(b"hev1");
    dir.write("hevc.mp4", &bytes);
    let words = ["hevc.mp4", "ffmpeg", "install"];
    dir.refused_with("geometry hevc.mp4 -o never", &[("PATH", "")], 69, &words);
}

#[test]
fn audio_without_video_is_rejected() {
    let dir = Scratch::new();
    let source = ["-f", "lavfi", "-i", "sine=duration=0.3", "-c:a", "aac"];
    let made = Command::new("ffmpeg").args(source).arg(dir.path("sound.mp4")).output();
    if !made.is_ok_and(|o| o.status.success()) {
        skip(Need::Ffmpeg, "no ffmpeg is here to make a file with sound alone");
        return;
    }
    bad_video(&dir, "sound.mp4", 65, &["sound.mp4", "no video track"]);
}

#[test]
fn folders_of_images_that_are_not_a_clip_are_rejected() {
    let dir = Scratch::new();
    write_images(&dir.path("one"), 2);
    fs::remove_file(dir.path("one/00001.png")).unwrap();
    bad_video(&dir, "one", 65, &["at least 2"]);

    write_images(&dir.path("broken"), 3);
    dir.write("broken/00001.png", "no image");
    bad_video(&dir, "broken", 65, &["00001.png"]);

    write_images(&dir.path("sizes"), 2);
    write_rgb(&dir.path("sizes/00001.png"), &Plane::filled(32, 32, [9; 3])).unwrap();
    bad_video(&dir, "sizes", 65, &["00001.png", "32 x 32", "one size"]);

    for i in 0..4 {
        write_rgb(&dir.path(&format!("flat/{i}.png")), &Plane::filled(96, 96, [80; 3])).unwrap();
    }
    bad_video(&dir, "flat", 65, &["points could be tracked", "--static-camera"]);
}

#[test]
fn unknown_and_invalid_settings_are_rejected() {
    let dir = Scratch::new();
    let meant = "did you mean \"train.iterations\"?";
    for (given, words) in [
        ("train.iteratons=5", &["train.iteratons", meant][..]),
        ("iterations=5", &[meant]),
        ("train.iterations=many", &["train.iterations", "\"many\"", "usize"]),
        ("train.iterations=-4", &["train.iterations", "-4"]),
        ("train.iterations", &["key=value"]),
        ("=5", &["key=value"]),
        ("profile=best", &["profile", "best", "faithful"]),
        ("init.opacity=0.5", &["init.opacity", "max_static"]),
    ] {
        dir.refused(&format!("train --print-config --set {given}"), 78, words);
    }
    for (file, toml, words) in [
        ("syntax.toml", "[train\niterations = 5", &["not valid TOML", "line 1"][..]),
        ("key.toml", "[train]\nloss = { lambda = 0.3 }", &["train.loss.lambda", "lambda_ssim"]),
        ("type.toml", "[train.refine]\nposes = 3", &["train.refine.poses = 3", "boolean"]),
    ] {
        dir.write(file, toml);
        let words = [&[file][..], words].concat();
        dir.refused(&format!("train --print-config --config {file}"), 78, &words);
    }
    dir.refused("train --print-config --config missing.toml", 66, &["missing.toml"]);

    write_capture(&dir.path("capture"), false);
    for (given, words) in [
        ("train.loss.lambda_ssim=3", ["lambda_ssim", "between 0 and 1"]),
        ("init.keyframe_gaps=0", ["keyframe_gaps", "above 0"]),
        ("train.density.every=0", ["density.every", "at least 1"]),
    ] {
        dir.refused(&format!("train capture -o never --set {given}"), 78, &words);
    }
    assert!(!dir.path("never").exists(), "nothing is made before the settings are checked");
    let level = [("MINUTE4D_SIMD", "quantum")];
    dir.refused_with("train capture -o never", &level, 69, &["quantum", "choose one of"]);
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
        (finished.as_str(), &["a finished run", "--resume", "--force"]),
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
        edit_transforms(&dir.path("capture"), |list| edit(list, &dir.path("capture")));
        dir.refused("train capture -o never --iterations 5", code, words);
        assert!(!dir.path("never/scene.safetensors").exists(), "nothing is made of a bad capture");
    };
    spoil(65, &["frame 2", "transform_matrix"], &|list, _| list["frames"][2]["transform_matrix"] = Value::Null);
    spoil(65, &["frame 1", "transform_matrix"], &|list, _| {
        list["frames"][1]["transform_matrix"] = json!([[1, 0], [0, 1]]);
    });
    spoil(65, &["frame 0", "transform_matrix"], &|list, _| list["frames"][0]["transform_matrix"][0][0] = json!(7.5));
    spoil(66, &["frame 3", "gone.png"], &|list, _| list["frames"][3]["file_path"] = json!("train/gone.png"));
    spoil(65, &["frame 4", "w = 600", "has 64"], &|list, _| list["frames"][4]["w"] = json!(600));
    spoil(65, &["k4 = 0.2"], &|list, _| list["k4"] = json!(0.2));
    spoil(65, &["lists no frames"], &|list, _| list["frames"] = json!([]));
    spoil(65, &["frame 1", "time"], &|list, _| list["frames"][1]["time"] = json!(7));
    spoil(65, &["fl_x"], &|list, _| {
        for frame in list["frames"].as_array_mut().unwrap() {
            frame["fl_x"] = json!(-60);
        }
    });
    spoil(65, &["00002.png", "depth"], &|_, folder| {
        write_rgb(&folder.join("depth/00002.png"), &Plane::filled(64, 48, [9; 3])).unwrap();
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
    write_capture(&dir.path("capture"), false);
    let list = "capture/transforms_train.json";
    let good = String::from_utf8(dir.read(list)).unwrap();
    for (text, word) in [(&*good.replacen("64.0", "NaN", 1), "NaN"), (&good[..good.len() / 2], "EOF")] {
        dir.write(list, text);
        dir.refused("train capture -o never", 65, &["transforms_train.json", word]);
    }
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
    dir.write("half.safetensors", &good[..good.len() / 2]);
    dir.write("words.safetensors", "not tensors");
    let damaged = ["flipped.safetensors", "damaged"];
    dir.refused("render flipped.safetensors -o never", 65, &damaged);
    dir.refused("inspect flipped.safetensors", 65, &damaged);
    dir.refused("render half.safetensors -o never", 65, &["half.safetensors"]);
    let words = ["words.safetensors", "not a scene"];
    dir.refused("render words.safetensors -o never", 65, &words);
    dir.refused("render missing -o never", 66, &["missing"]);
    assert!(!dir.path("never").exists());
}

#[test]
fn impossible_views_are_rejected() {
    let dir = Scratch::new();
    dir.write("empty.json", "{\"frames\": []}");
    dir.write("broken.json", "{\"frames\": [{\"transform_matrix\": [[1]]}], \"fl_x\": 60, \"w\": 64, \"h\": 48}");
    dir.write("there.mp4", "mine");
    for (options, code, words) in [
        ("-o never --time later", 2, &["\"later\"", "freeze@T"][..]),
        ("-o never --time freeze@x", 2, &["\"freeze@x\""]),
        ("-o never --time freeze@6", 2, &["frame 6", "0 to 5"]),
        ("-o never --time 0s..9s", 2, &["9s", "outside"]),
        ("-o never --path gone.json", 66, &["gone.json"]),
        ("-o never --path empty.json", 65, &["empty.json"]),
        ("-o never --path broken.json", 65, &["broken.json"]),
        ("-o there.mp4", 73, &["there.mp4", "already exists", "--force"]),
    ] {
        dir.refused(&format!("render '{}' {options}", finished_run()), code, words);
    }
    assert!(!dir.path("never").exists());
    assert_eq!(dir.read("there.mp4"), b"mine");
}

#[test]
fn eval_without_ground_truth_is_rejected() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    dir.write("poses.json", "{\"poses\": [[[1,1,0,5,48],[0,1,0,6,64],[0,0,1,7,50]]]}");
    let run = finished_run();
    let words = ["transforms_test.json", "held-out"];
    dir.refused(&format!("eval '{run}' --data capture"), 65, &words);
    dir.refused(&format!("eval '{run}' --data missing"), 66, &["missing"]);
    for (line, code, words) in [
        ("eval no-run --data capture", 66, &["scene.safetensors"][..]),
        ("eval-geometry capture --truth missing", 66, &["missing"]),
        ("eval-geometry capture --truth poses.json", 65, &["poses.json", "pose 0"]),
        ("inspect missing", 66, &["missing"]),
    ] {
        dir.refused(line, code, words);
    }
}
