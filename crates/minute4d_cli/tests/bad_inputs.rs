//! What the program says to bad inputs: each case names its exit code and the words that must be in
//! the message, and `--json` must end with `ok: false`.

use crate::common::{
    Scratch, edit_transforms, refused, refused_with, text, train, write_capture, write_images, write_video,
};
use m4_testkit::{Need, skip};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

/// A finished run, made once for all tests that only read it.
fn finished_run() -> &'static Path {
    static RUN: OnceLock<Scratch> = OnceLock::new();
    static PATH: OnceLock<std::path::PathBuf> = OnceLock::new();
    PATH.get_or_init(|| {
        let dir = RUN.get_or_init(Scratch::new);
        write_capture(&dir.path("capture"), false);
        let ended = train(&dir.at("capture"), &dir.at("out"), "10", &[]);
        assert_eq!(ended.code, 0, "{}", ended.stderr);
        dir.path("out")
    })
}

/// `geometry INPUT`, which must be refused.
fn bad_video(dir: &Scratch, input: &str, more: &[&str], code: i32, words: &[&str]) {
    let out = dir.at("never");
    let args = ["geometry", input, "-o", &out];
    let args: Vec<&str> = args.iter().chain(more).copied().collect();
    refused(&args, code, words);
    assert!(!dir.path("never/transforms_train.json").exists());
}

#[test]
fn files_that_are_not_videos_are_rejected() {
    let dir = Scratch::new();
    bad_video(
        &dir,
        &dir.at("missing.mp4"),
        &[],
        66,
        &["missing.mp4", "there is no video"],
    );
    fs::create_dir(dir.path("empty")).unwrap();
    bad_video(&dir, &dir.at("empty"), &[], 65, &["empty", "no image"]);
    let zero = dir.write("zero.mp4", b"");
    bad_video(&dir, &zero, &[], 65, &["zero.mp4", "empty (0 bytes)"]);
    let zeros = dir.write("zeros.mp4", [0; 5000]);
    bad_video(&dir, &zeros, &[], 65, &["zeros.mp4", "not a video"]);
}

#[test]
fn damaged_videos_are_rejected() {
    let dir = Scratch::new();
    write_video(&dir.path("good.mp4"), 8);
    let bytes = fs::read(dir.path("good.mp4")).unwrap();
    // Within the index: nothing can be found. Within the images: some are missing.
    let index = dir.write("index.mp4", &bytes[..200]);
    bad_video(&dir, &index, &[], 65, &["index.mp4", "incomplete"]);
    let half = dir.write("half.mp4", &bytes[..bytes.len() / 2]);
    bad_video(&dir, &half, &["--strict-video"], 65, &["half.mp4"]);
    let good = dir.at("good.mp4");
    bad_video(&dir, &good, &["--start", "100"], 65, &["good.mp4", "no frame in"]);
    bad_video(&dir, &good, &["--start", "2", "--end", "1"], 78, &["end"]);
}

#[test]
fn codec_without_a_decoder_names_ffmpeg() {
    let dir = Scratch::new();
    write_video(&dir.path("good.mp4"), 8);
    let mut bytes = fs::read(dir.path("good.mp4")).unwrap();
    let at = bytes
        .windows(4)
        .position(|w| w == b"avc1")
        .expect("the codec is named in the index");
    // The brand at the front may have the same name; the last one is that of the track.
    let at = bytes.windows(4).rposition(|w| w == b"avc1").unwrap_or(at);
    bytes[at..at + 4].copy_from_slice(b"hev1");
    let hevc = dir.write("hevc.mp4", &bytes);
    let out = dir.at("never");
    refused_with(
        &["geometry", &hevc, "-o", &out],
        &[("PATH", "")],
        69,
        &["hevc.mp4", "ffmpeg", "install"],
    );
}

#[test]
fn audio_without_video_is_rejected() {
    let dir = Scratch::new();
    let path = dir.path("sound.mp4");
    let source = ["-f", "lavfi", "-i", "sine=duration=0.3", "-c:a", "aac"];
    let made = Command::new("ffmpeg").args(source).arg(&path).output();
    if !made.is_ok_and(|o| o.status.success()) {
        skip(Need::Ffmpeg, "no ffmpeg is here to make a file with sound alone");
        return;
    }
    bad_video(&dir, text(&path), &[], 65, &["sound.mp4", "no video track"]);
}

#[test]
fn folders_of_images_that_are_not_a_clip_are_rejected() {
    let dir = Scratch::new();
    write_images(&dir.path("one"), 2);
    fs::remove_file(dir.path("one/00001.png")).unwrap();
    bad_video(&dir, &dir.at("one"), &[], 65, &["at least 2"]);

    write_images(&dir.path("broken"), 3);
    dir.write("broken/00001.png", "no image");
    bad_video(&dir, &dir.at("broken"), &[], 65, &["00001.png"]);

    write_images(&dir.path("sizes"), 2);
    let small = minute4d::core::Plane::filled(32, 32, [9; 3]);
    minute4d::io::image::write_rgb(&dir.path("sizes/00001.png"), &small).unwrap();
    bad_video(&dir, &dir.at("sizes"), &[], 65, &["00001.png", "32 x 32", "one size"]);

    for i in 0..4 {
        let flat = minute4d::core::Plane::filled(96, 96, [80; 3]);
        minute4d::io::image::write_rgb(&dir.path(&format!("flat/{i}.png")), &flat).unwrap();
    }
    bad_video(
        &dir,
        &dir.at("flat"),
        &[],
        65,
        &["points could be tracked", "--static-camera"],
    );
}

#[test]
fn unknown_and_invalid_settings_are_rejected() {
    let dir = Scratch::new();
    let set = |given: &str, words: &[&str]| refused(&["train", "--print-config", "--set", given], 78, words);
    set(
        "train.iteratons=5",
        &["train.iteratons", "did you mean \"train.iterations\"?"],
    );
    set("iterations=5", &["did you mean \"train.iterations\"?"]);
    set("train.iterations=many", &["train.iterations", "\"many\"", "usize"]);
    set("train.iterations=-4", &["train.iterations", "-4"]);
    set("train.iterations", &["key=value"]);
    set("=5", &["key=value"]);
    set("profile=best", &["profile", "best", "faithful"]);
    set("init.opacity=0.5", &["init.opacity", "max_static"]);

    let file = |name: &str, toml: &str, code: i32, words: &[&str]| {
        let path = dir.write(name, toml);
        refused(&["train", "--print-config", "--config", &path], code, words);
    };
    file(
        "syntax.toml",
        "[train\niterations = 5",
        78,
        &["syntax.toml", "not valid TOML", "line 1"],
    );
    file(
        "key.toml",
        "[train]\nloss = { lambda = 0.3 }",
        78,
        &["key.toml", "train.loss.lambda", "lambda_ssim"],
    );
    file(
        "type.toml",
        "[train.refine]\nposes = 3",
        78,
        &["type.toml", "train.refine.poses = 3", "boolean"],
    );
    let missing = dir.at("missing.toml");
    refused(
        &["train", "--print-config", "--config", &missing],
        66,
        &["missing.toml"],
    );

    write_capture(&dir.path("capture"), false);
    let (data, out) = (dir.at("capture"), dir.at("never"));
    let range = |given: &str, words: &[&str]| refused(&["train", &data, "-o", &out, "--set", given], 78, words);
    range("train.loss.lambda_ssim=3", &["lambda_ssim", "between 0 and 1"]);
    range("init.keyframe_gaps=0", &["keyframe_gaps", "above 0"]);
    range("train.density.every=0", &["density.every", "at least 1"]);
    assert!(
        !dir.path("never").exists(),
        "nothing is made before the settings are checked"
    );
    let level = [("MINUTE4D_SIMD", "quantum")];
    refused_with(&["train", &data, "-o", &out], &level, 69, &["quantum", "choose one of"]);
}

#[test]
fn conflicting_arguments_are_rejected() {
    refused(&["frobnicate"], 2, &["frobnicate"]);
    refused(&["run", "a", "-o", "b", "--iterations", "0"], 2, &["0", "--iterations"]);
    refused(&["run", "a", "-o", "b", "--threads", "0"], 2, &["0", "--threads"]);
    refused(&["run", "a", "-o", "b", "--profile", "best"], 2, &["best", "--profile"]);
    refused(
        &["run", "a", "-o", "b", "--fov", "400"],
        2,
        &["400", "between 5 and 170"],
    );
    refused(
        &["run", "a", "-o", "b", "--resume", "--force"],
        2,
        &["--resume", "--force"],
    );
    refused(&["run", "a"], 2, &["--out"]);
    refused(&["train", "--seed", "-1"], 2, &["-1"]);
}

#[test]
fn impossible_outputs_are_rejected() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let data = dir.at("capture");
    let to = |out: &str, more: &[&str], words: &[&str]| {
        let args = ["train", &data, "-o", out, "--iterations", "5"];
        let args: Vec<&str> = args.iter().chain(more).copied().collect();
        refused(&args, 73, words);
    };
    let file = dir.write("file", "mine");
    to(&file, &[], &["file", "a file with that name exists"]);
    to(&dir.at("file/out"), &[], &["file", "cannot write"]);
    fs::create_dir(dir.path("foreign")).unwrap();
    dir.write("foreign/thesis.txt", "mine");
    to(&dir.at("foreign"), &[], &["foreign", "not made by minute4d", "--force"]);
    to(&dir.at("foreign"), &["--resume"], &["foreign", "not made by minute4d"]);
    to(text(finished_run()), &[], &["a finished run", "--resume", "--force"]);
    assert_eq!(fs::read_to_string(dir.path("foreign/thesis.txt")).unwrap(), "mine");
    assert_eq!(fs::read_dir(dir.path("foreign")).unwrap().count(), 1);
    write_video(&dir.path("clip.mp4"), 3);
    refused(
        &["geometry", &dir.at("clip.mp4"), "-o", &data],
        73,
        &["not made by minute4d", "geometry.json"],
    );
}

#[test]
fn inconsistent_captures_are_rejected() {
    let spoil = |code: i32, words: &[&str], edit: &dyn Fn(&mut Value, &Path)| {
        let dir = Scratch::new();
        write_capture(&dir.path("capture"), false);
        edit_transforms(&dir.path("capture"), |list| edit(list, &dir.path("capture")));
        refused(
            &["train", &dir.at("capture"), "-o", &dir.at("never"), "--iterations", "5"],
            code,
            words,
        );
        assert!(
            !dir.path("never/scene.safetensors").exists(),
            "nothing is made of a bad capture"
        );
    };
    spoil(65, &["frame 2", "transform_matrix"], &|list, _| {
        list["frames"][2]["transform_matrix"] = Value::Null
    });
    spoil(65, &["frame 1", "transform_matrix"], &|list, _| {
        list["frames"][1]["transform_matrix"] = json!([[1, 0], [0, 1]]);
    });
    spoil(65, &["frame 0", "transform_matrix"], &|list, _| {
        list["frames"][0]["transform_matrix"][0][0] = json!(7.5)
    });
    spoil(66, &["frame 3", "gone.png"], &|list, _| {
        list["frames"][3]["file_path"] = json!("train/gone.png")
    });
    spoil(65, &["frame 4", "w = 600", "has 64"], &|list, _| {
        list["frames"][4]["w"] = json!(600)
    });
    spoil(65, &["k4 = 0.2"], &|list, _| list["k4"] = json!(0.2));
    spoil(65, &["lists no frames"], &|list, _| list["frames"] = json!([]));
    spoil(65, &["frame 1", "time"], &|list, _| {
        list["frames"][1]["time"] = json!(7)
    });
    spoil(65, &["fl_x"], &|list, _| {
        for frame in list["frames"].as_array_mut().unwrap() {
            frame["fl_x"] = json!(-60);
        }
    });
    spoil(65, &["00002.png", "depth"], &|list, folder| {
        let _ = list;
        let flat = minute4d::core::Plane::filled(64, 48, [9; 3]);
        minute4d::io::image::write_rgb(&folder.join("depth/00002.png"), &flat).unwrap();
    });
    spoil(65, &["depth", "geometry"], &|list, _| {
        for frame in list["frames"].as_array_mut().unwrap() {
            frame.as_object_mut().unwrap().remove("depth_file_path");
        }
    });
    spoil(65, &["no usable depth", "unit"], &|list, folder| {
        let none = minute4d::core::Plane::filled(64, 48, 0.0f32);
        for i in 0..list["frames"].as_array().unwrap().len() {
            minute4d::io::image::write_depth(&folder.join(format!("depth/{i:05}.png")), &none, 0.001).unwrap();
        }
    });
}

#[test]
fn folders_that_are_not_captures_are_rejected() {
    let dir = Scratch::new();
    fs::create_dir(dir.path("empty")).unwrap();
    let out = dir.at("never");
    refused(&["train", &dir.at("empty"), "-o", &out], 66, &["transforms_train.json"]);
    refused(&["train", &dir.at("missing"), "-o", &out], 66, &["no capture at"]);
    write_capture(&dir.path("capture"), false);
    let list = dir.path("capture/transforms_train.json");
    let good = fs::read_to_string(&list).unwrap();
    fs::write(&list, good.replacen("64.0", "NaN", 1)).unwrap();
    refused(
        &["train", &dir.at("capture"), "-o", &out],
        65,
        &["transforms_train.json", "NaN"],
    );
    fs::write(&list, &good[..good.len() / 2]).unwrap();
    refused(
        &["train", &dir.at("capture"), "-o", &out],
        65,
        &["transforms_train.json", "EOF"],
    );
    assert!(!dir.path("never").exists());
}

#[test]
fn damaged_scenes_are_rejected() {
    let dir = Scratch::new();
    let good = fs::read(finished_run().join("scene.safetensors")).unwrap();
    let out = dir.at("never");
    let mut flipped = good.clone();
    let last = flipped.len() - 5;
    flipped[last] ^= 1;
    let flipped = dir.write("flipped.safetensors", flipped);
    refused(
        &["render", &flipped, "-o", &out],
        65,
        &["flipped.safetensors", "damaged"],
    );
    refused(&["inspect", &flipped], 65, &["flipped.safetensors", "damaged"]);
    let half = dir.write("half.safetensors", &good[..good.len() / 2]);
    refused(&["render", &half, "-o", &out], 65, &["half.safetensors"]);
    let words = dir.write("words.safetensors", "not tensors");
    refused(
        &["render", &words, "-o", &out],
        65,
        &["words.safetensors", "not a scene"],
    );
    refused(&["render", &dir.at("missing"), "-o", &out], 66, &["missing"]);
    assert!(!dir.path("never").exists());
}

#[test]
fn impossible_views_are_rejected() {
    let dir = Scratch::new();
    let (run, out) = (text(finished_run()), dir.at("never"));
    let time = |given: &str, words: &[&str]| refused(&["render", run, "-o", &out, "--time", given], 2, words);
    time("later", &["\"later\"", "freeze@T"]);
    time("freeze@x", &["\"freeze@x\""]);
    time("freeze@6", &["frame 6", "0 to 5"]);
    time("0s..9s", &["9s", "outside"]);
    refused(
        &["render", run, "-o", &out, "--path", &dir.at("gone.json")],
        66,
        &["gone.json"],
    );
    let empty = dir.write("empty.json", "{\"frames\": []}");
    refused(&["render", run, "-o", &out, "--path", &empty], 65, &["empty.json"]);
    let broken = dir.write(
        "broken.json",
        "{\"frames\": [{\"transform_matrix\": [[1]]}], \"fl_x\": 60, \"w\": 64, \"h\": 48}",
    );
    refused(&["render", run, "-o", &out, "--path", &broken], 65, &["broken.json"]);
    assert!(!dir.path("never").exists());
    let there = dir.write("there.mp4", "mine");
    refused(
        &["render", run, "-o", &there],
        73,
        &["there.mp4", "already exists", "--force"],
    );
    assert_eq!(fs::read_to_string(&there).unwrap(), "mine");
}

#[test]
fn eval_without_ground_truth_is_rejected() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let (run, data) = (text(finished_run()), dir.at("capture"));
    refused(
        &["eval", run, "--data", &data],
        65,
        &["transforms_test.json", "held-out"],
    );
    refused(&["eval", run, "--data", &dir.at("missing")], 66, &["missing"]);
    refused(
        &["eval", &dir.at("no-run"), "--data", &data],
        66,
        &["scene.safetensors"],
    );
    refused(
        &["eval-geometry", &data, "--truth", &dir.at("missing")],
        66,
        &["missing"],
    );
    let skewed = dir.write("poses.json", "{\"poses\": [[[1,1,0,5,48],[0,1,0,6,64],[0,0,1,7,50]]]}");
    refused(
        &["eval-geometry", &data, "--truth", &skewed],
        65,
        &["poses.json", "pose 0"],
    );
    refused(&["inspect", &dir.at("missing")], 66, &["missing"]);
}
