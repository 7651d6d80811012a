//! Camera paths from outside: every path is rendered, at sizes that no camera of the video has.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{SIZE, Scratch, write_capture};
use minute4d::io::image::read_rgb;
use std::path::Path;
use std::sync::OnceLock;

/// A trained scene of six frames in half a second, made once.
fn run() -> &'static str {
    static RUN: OnceLock<(Scratch, String)> = OnceLock::new();
    let (_, out) = RUN.get_or_init(|| {
        let dir = Scratch::new();
        write_capture(&dir.path("capture"), false);
        dir.succeed("train capture -o out --iterations 60");
        let out = dir.at("out");
        (dir, out)
    });
    out
}

/// `render` of that scene, with these options.
fn line(options: &str) -> String {
    format!("render '{}' {options}", run())
}

/// Mean absolute difference of two images of one size, levels.
fn difference(a: &Path, b: &Path) -> f64 {
    let (a, b) = (read_rgb(a).unwrap(), read_rgb(b).unwrap());
    assert_eq!(a.size(), b.size());
    let pixels = a.data().as_flattened().iter().zip(b.data().as_flattened());
    let sum: f64 = pixels.map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    sum / (3 * a.data().len()) as f64
}

#[test]
fn every_path_is_rendered_at_an_odd_size() {
    let dir = Scratch::new();
    for (path, more, frames) in [
        ("source", "--seconds 1", 13),
        ("stabilised", "--smooth-s 0.1 --zoom 1.2", 7),
        ("swing", "--seconds 1 --time play", 12),
        ("bullet", "--hold-s 0.5 --at 0.2s", 17),
    ] {
        let options = format!("--path {path} --fps 12 --size 51x37 -o {path}.mp4 --json {more}");
        let result = dir.succeed(&line(&options)).result();
        assert_eq!(
            (&result["frames"], &result["width"], &result["height"]),
            (&frames.into(), &51.into(), &37.into()),
            "{path}"
        );
        let seen = dir.succeed(&format!("inspect {path}.mp4 --json")).result();
        assert_eq!(
            (&seen["frames"], &seen["size"][0], &seen["size"][1]),
            (&frames.into(), &52.into(), &38.into()),
            "{path}: {seen}"
        );
    }
    dir.succeed(&line("--path swing --seconds 0.5 --fps 10 --size 33x21 -o png"));
    assert_eq!(dir.count("png"), 5);
    assert_eq!(read_rgb(&dir.path("png/00004.png")).unwrap().size(), (33, 21));
    // A shorter render replaces a longer one, and leaves what is not its own.
    dir.write("png/note.txt", "mine");
    dir.succeed(&line("--path swing --seconds 0.2 --fps 10 -o png --force"));
    assert_eq!(dir.count("png"), 3);
    assert_eq!(read_rgb(&dir.path("png/00000.png")).unwrap().size(), SIZE);
}

#[test]
fn single_image_equals_the_video_frame() {
    let dir = Scratch::new();
    dir.succeed(&line("--path source --at 0.3s -o one.png"));
    dir.succeed(&line("--path train -o all"));
    assert_eq!(dir.count("all"), 6);
    let one = dir.path("one.png");
    assert!(difference(&one, &dir.path("all/00003.png")) < 0.01);
    assert!(difference(&one, &dir.path("all/00000.png")) > 1.0, "another moment looks different");
    // Twice the size of a crop of the middle is the same view.
    dir.succeed(&line("--path source --at 3 --size 48x48 -o cropped.png"));
    let (small, whole) = (read_rgb(&dir.path("cropped.png")).unwrap(), read_rgb(&one).unwrap());
    assert!((0..48).all(|y| (0..48).all(|x| (0..3).all(|c| small[(x, y)][c].abs_diff(whole[(x + 8, y)][c]) <= 2))));
}

#[test]
fn camera_and_keyframe_files_are_rendered() {
    let dir = Scratch::new();
    // The first camera of the video stands in the origin and looks along z with 54 degrees.
    dir.write(
        "own.json",
        r#"{"format": "minute4d-path", "version": 1, "width": 31, "height": 23, "fps": 10, "keyframes": [
            {"time_s": 0, "position": [0, 0, 0], "look_at": [0, 0, 4], "scene_s": 0.1},
            {"time_s": 0.5, "position": [0.3, 0, 0], "look_at": [0, 0, 4], "scene_s": 0.4}]}"#,
    );
    dir.succeed(&line("--path own.json -o own"));
    assert_eq!(dir.count("own"), 6);
    assert_eq!(read_rgb(&dir.path("own/00005.png")).unwrap().size(), (31, 23));
    let still = dir.succeed(&line("--path train --at 0 --size 31x23 -o still.png"));
    assert!(!still.stderr.contains("warning"), "{}", still.stderr);

    dir.write(
        "listed.json",
        r#"{"w": 64, "h": 48, "fl_x": 60.3, "frames": [
            {"transform_matrix": [[1,0,0,0], [0,-1,0,0], [0,0,-1,0], [0,0,0,1]]},
            {"transform_matrix": [[1,0,0,0.4], [0,-1,0,0], [0,0,-1,0], [0,0,0,1]]}]}"#,
    );
    dir.succeed(&line("--path listed.json -o listed"));
    dir.succeed(&line("--path train -o train"));
    // the same lens at the same place at the same time
    let off = difference(&dir.path("listed/00000.png"), &dir.path("train/00000.png"));
    assert!(off < 6.0, "{off} levels apart");
}

#[test]
fn impossible_renders_are_rejected_before_writing() {
    let dir = Scratch::new();
    dir.write("broken.json", r#"{"format": "minute4d-path", "version": 1, "keyframes": [{"time_s": 0}]}"#);
    dir.write("there.png", "mine");
    for (options, code, words) in [
        ("-o never --path swing --hold-s 3", 2, &["--hold-s", "swing", "--degrees"][..]),
        ("-o never --path train --seconds 3", 2, &["--seconds", "--at"]),
        ("-o never --path bullet --hold-s 1000", 2, &["--hold-s", "0.1 to 600"]),
        ("-o never --path swing --amount nan", 2, &["--amount"]),
        ("-o never --path swing --seconds -1", 2, &["--seconds"]),
        ("-o never --path swing --seconds 3600 --fps 240", 2, &["864000 images"]),
        ("-o never --path bullet --seconds 2", 2, &["--hold-s"]),
        ("-o never --path bullet --at 9s", 2, &["9s", "outside"]),
        ("-o never --path bullet --at soon", 2, &["\"soon\"", "not a time"]),
        ("-o never --path spiral", 2, &["spiral", "bullet"]),
        ("-o never --path broken.json", 65, &["broken.json", "camera 0", "look_at"]),
        ("-o never --size 99999x9", 2, &["each side 1 to 16384"]),
        ("-o a.mov --path swing", 2, &["a.mov", ".mp4"]),
        ("-o a.png --path swing", 2, &["a.png", "one image"]),
        ("-o there.png --path source --at 0", 73, &["--force"]),
        ("-o tiny.mp4 --path swing --size 9x9", 65, &["9 x 9", "PNG"]),
    ] {
        dir.refused(&line(options), code, words);
    }
    for name in ["never", "a.mov", "a.png", "tiny.mp4"] {
        assert!(!dir.path(name).exists(), "{name}");
    }
    assert_eq!(dir.read("there.png"), b"mine");
}
