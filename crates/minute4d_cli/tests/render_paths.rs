//! Camera paths from outside: every path is rendered, at sizes that no camera of the video has.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{SIZE, Scratch, refused, succeed, text, train, write_capture};
use minute4d::io::image::read_rgb;
use std::fs;
use std::path::Path;
use std::sync::OnceLock;

/// A trained scene of six frames in half a second, made once.
fn run() -> &'static str {
    static RUN: OnceLock<(Scratch, String)> = OnceLock::new();
    let (_, out) = RUN.get_or_init(|| {
        let dir = Scratch::new();
        write_capture(&dir.path("capture"), false);
        let out = dir.at("out");
        let ended = train(&dir.at("capture"), &out, "60", &[]);
        assert_eq!(ended.code, 0, "{}", ended.stderr);
        (dir, out)
    });
    out
}

fn files(folder: &Path) -> usize {
    fs::read_dir(folder).unwrap().count()
}

/// Mean absolute difference of two images of one size, levels.
fn difference(a: &Path, b: &Path) -> f64 {
    let (a, b) = (read_rgb(a).unwrap(), read_rgb(b).unwrap());
    assert_eq!(a.size(), b.size());
    let (w, h) = a.size();
    let mut sum = 0.0;
    for y in 0..h {
        for x in 0..w {
            sum += (0..3)
                .map(|c| f64::from(a[(x, y)][c].abs_diff(b[(x, y)][c])))
                .sum::<f64>();
        }
    }
    sum / (3 * w * h) as f64
}

#[test]
fn every_path_is_rendered_at_an_odd_size() {
    let dir = Scratch::new();
    for (path, more, frames) in [
        ("source", &["--seconds", "1"][..], 13),
        ("stabilised", &["--smooth-s", "0.1", "--zoom", "1.2"], 7),
        ("swing", &["--seconds", "1", "--time", "play"], 12),
        ("bullet", &["--hold-s", "0.5", "--at", "0.2s"], 17),
    ] {
        let out = dir.at(&format!("{path}.mp4"));
        let args = [
            "render",
            run(),
            "--path",
            path,
            "--fps",
            "12",
            "--size",
            "51x37",
            "-o",
            &out,
            "--json",
        ];
        let args: Vec<&str> = args.iter().chain(more).copied().collect();
        let result = succeed(&args).result();
        assert_eq!(
            (&result["frames"], &result["width"], &result["height"]),
            (&frames.into(), &51.into(), &37.into()),
            "{path}"
        );
        let seen = succeed(&["inspect", &out, "--json"]).result();
        assert_eq!(seen["frames"], frames, "{path}: {seen}");
        assert_eq!(
            (&seen["size"][0], &seen["size"][1]),
            (&52.into(), &38.into()),
            "{path}: {seen}"
        );
    }
    let png = dir.at("png");
    succeed(&[
        "render",
        run(),
        "--path",
        "swing",
        "--seconds",
        "0.5",
        "--fps",
        "10",
        "--size",
        "33x21",
        "-o",
        &png,
    ]);
    assert_eq!(files(&dir.path("png")), 5);
    assert_eq!(read_rgb(&dir.path("png/00004.png")).unwrap().size(), (33, 21));
    // A shorter render replaces a longer one, and leaves what is not its own.
    dir.write("png/note.txt", "mine");
    succeed(&[
        "render",
        run(),
        "--path",
        "swing",
        "--seconds",
        "0.2",
        "--fps",
        "10",
        "-o",
        &png,
        "--force",
    ]);
    assert_eq!(files(&dir.path("png")), 3);
    assert_eq!(read_rgb(&dir.path("png/00000.png")).unwrap().size(), SIZE);
}

#[test]
fn single_image_equals_the_video_frame() {
    let dir = Scratch::new();
    let one = dir.at("one.png");
    succeed(&["render", run(), "--path", "source", "--at", "0.3s", "-o", &one]);
    let all = dir.at("all");
    succeed(&["render", run(), "--path", "train", "-o", &all]);
    assert_eq!(files(&dir.path("all")), 6);
    assert!(difference(&dir.path("one.png"), &dir.path("all/00003.png")) < 0.01);
    assert!(
        difference(&dir.path("one.png"), &dir.path("all/00000.png")) > 1.0,
        "another moment looks different"
    );
    // Twice the size of a crop of the middle is the same view.
    let cropped = dir.at("cropped.png");
    succeed(&[
        "render",
        run(),
        "--path",
        "source",
        "--at",
        "3",
        "--size",
        "48x48",
        "-o",
        &cropped,
    ]);
    let (small, whole) = (
        read_rgb(Path::new(&cropped)).unwrap(),
        read_rgb(Path::new(&one)).unwrap(),
    );
    assert!((0..48).all(|y| (0..48).all(|x| (0..3).all(|c| small[(x, y)][c].abs_diff(whole[(x + 8, y)][c]) <= 2))));
}

#[test]
fn camera_and_keyframe_files_are_rendered() {
    let dir = Scratch::new();
    // The first camera of the video stands in the origin and looks along z with 54 degrees.
    let own = dir.write(
        "own.json",
        r#"{"format": "minute4d-path", "version": 1, "width": 31, "height": 23, "fps": 10, "keyframes": [
            {"time_s": 0, "position": [0, 0, 0], "look_at": [0, 0, 4], "scene_s": 0.1},
            {"time_s": 0.5, "position": [0.3, 0, 0], "look_at": [0, 0, 4], "scene_s": 0.4}]}"#,
    );
    succeed(&["render", run(), "--path", &own, "-o", &dir.at("own")]);
    assert_eq!(files(&dir.path("own")), 6);
    assert_eq!(read_rgb(&dir.path("own/00005.png")).unwrap().size(), (31, 23));
    let still = succeed(&[
        "render",
        run(),
        "--path",
        "train",
        "--at",
        "0",
        "--size",
        "31x23",
        "-o",
        &dir.at("still.png"),
    ]);
    assert!(
        still.stderr.is_empty() || !still.stderr.contains("warning"),
        "{}",
        still.stderr
    );

    let listed = dir.write(
        "listed.json",
        r#"{"w": 64, "h": 48, "fl_x": 60.3, "frames": [
            {"transform_matrix": [[1,0,0,0], [0,-1,0,0], [0,0,-1,0], [0,0,0,1]]},
            {"transform_matrix": [[1,0,0,0.4], [0,-1,0,0], [0,0,-1,0], [0,0,0,1]]}]}"#,
    );
    succeed(&["render", run(), "--path", &listed, "-o", &dir.at("listed")]);
    succeed(&["render", run(), "--path", "train", "-o", &dir.at("train")]);
    // the same lens at the same place at the same time
    let off = difference(&dir.path("listed/00000.png"), &dir.path("train/00000.png"));
    assert!(off < 6.0, "{off} levels apart");
}

#[test]
fn impossible_renders_are_rejected_before_writing() {
    let dir = Scratch::new();
    let out = dir.at("never");
    let path = |path: &str, more: &[&str], code: i32, words: &[&str]| {
        let args = ["render", run(), "-o", &out, "--path", path];
        let args: Vec<&str> = args.iter().chain(more).copied().collect();
        refused(&args, code, words);
    };
    path("swing", &["--hold-s", "3"], 2, &["--hold-s", "swing", "--degrees"]);
    path("train", &["--seconds", "3"], 2, &["--seconds", "--at"]);
    path("bullet", &["--hold-s", "1000"], 2, &["--hold-s", "0.1 to 600"]);
    path("swing", &["--amount", "nan"], 2, &["--amount"]);
    path("swing", &["--seconds", "-1"], 2, &["--seconds"]);
    path("swing", &["--seconds", "3600", "--fps", "240"], 2, &["864000 images"]);
    path("bullet", &["--seconds", "2"], 2, &["--hold-s"]);
    path("bullet", &["--at", "9s"], 2, &["9s", "outside"]);
    path("bullet", &["--at", "soon"], 2, &["\"soon\"", "not a time"]);
    path("spiral", &[], 2, &["spiral", "bullet"]);
    let broken = dir.write(
        "broken.json",
        r#"{"format": "minute4d-path", "version": 1, "keyframes": [{"time_s": 0}]}"#,
    );
    path(&broken, &[], 65, &["broken.json", "camera 0", "look_at"]);
    assert!(!dir.path("never").exists());
    refused(
        &["render", run(), "--path", "swing", "-o", &dir.at("a.mov")],
        2,
        &["a.mov", ".mp4"],
    );
    refused(
        &["render", run(), "--path", "swing", "-o", &dir.at("a.png")],
        2,
        &["a.png", "one image"],
    );
    assert!(!dir.path("a.mov").exists() && !dir.path("a.png").exists());
    let there = dir.write("there.png", "mine");
    refused(
        &["render", run(), "--path", "source", "--at", "0", "-o", &there],
        73,
        &["--force"],
    );
    assert_eq!(fs::read_to_string(&there).unwrap(), "mine");
    let tiny = [
        "render",
        run(),
        "--path",
        "swing",
        "--size",
        "9x9",
        "-o",
        &dir.at("tiny.mp4"),
    ];
    refused(&tiny, 65, &["9 x 9", "PNG"]);
    let wide = text(&dir.path("wide")).to_owned();
    let size = crate::common::call(&["render", run(), "--size", "99999x9", "-o", &wide]);
    assert_eq!(size.code, 2, "{}", size.stderr);
}
