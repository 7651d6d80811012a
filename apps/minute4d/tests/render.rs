//! Images from outside: every camera path at sizes that no camera of the video has, and the page
//! while it plays, where every image belongs to one instant.

use crate::common::{SIZE, Scratch, finished_run, frames_of, write_clip};
use m4_core::nalgebra::{Matrix3, Vector3};
use m4_core::{Camera, Intrinsics, RgbImage, Scene, Se3};
use m4_io::image::read_rgb;
use m4_io::scene::safetensors;
use m4_kernels::SimdLevel;
use m4_testkit::{Chromium, find_chromium};
use minute4d::render::Painter;
use serde_json::Value;
use std::path::Path;

/// Pixels of the clip, and of the window that it is played in: nothing is scaled.
const PAGE_SIZE: (usize, usize) = (320, 240);
const FRAMES: usize = 24;
const FPS: f64 = 24.0;
/// A pixel is dynamic where dynamic splats change it by more than this, of 255.
const CHANGE: f32 = 8.0;
/// Least agreement with our renderer, dB, over the image and where it is dynamic.
const WHOLE_DB: f64 = 35.0;
const DYNAMIC_DB: f64 = 30.0;

/// State and image in one breath: nothing can be drawn between the two.
const SHOT: &str = "(() => { const view = document.querySelector('#view'); \
    const context = new OffscreenCanvas(view.width, view.height).getContext('2d'); context.drawImage(view, 0, 0); \
    return { ...minute4d.state(), rgba: [...context.getImageData(0, 0, view.width, view.height).data] }; })()";

/// An image of the page, and its metadata.
struct Shot {
    t: f64,
    camera: Camera,
    image: RgbImage,
}

fn shot(page: &mut Chromium) -> Shot {
    let state = page.eval(SHOT);
    let number = |value: &Value| value.as_f64().unwrap();
    let c2w: Vec<f64> = state["camera"]["c2w"]
        .as_array()
        .unwrap()
        .iter()
        .map(number)
        .collect();
    let k = |name: &str| number(&state["camera"][name]);
    let size = |name: &str| number(&state[name]) as usize;
    let (width, height) = (size("width"), size("height"));
    let camera = Camera {
        intrinsics: Intrinsics {
            fx: k("fx"),
            fy: k("fy"),
            cx: k("cx"),
            cy: k("cy"),
            width,
            height,
        },
        c2w: Se3 {
            rotation: Matrix3::from_fn(|row, column| c2w[4 * row + column]),
            translation: Vector3::new(c2w[3], c2w[7], c2w[11]),
        },
    };
    let rgba: Vec<u8> = state["rgba"]
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_u64().unwrap() as u8)
        .collect();
    Shot {
        t: number(&state["time"]),
        camera,
        image: RgbImage::from_fn(width, height, |x, y| {
            std::array::from_fn(|c| rgba[4 * (y * width + x) + c])
        }),
    }
}

/// Agreement of an image with our renderer at the time and the camera that the page reports, dB:
/// over all of it, and where dynamic splats change it.
fn agreement(shot: &Shot, all: &mut Painter<'_>, still: &mut Painter<'_>) -> (f64, f64) {
    let whole = &all.frame(&shot.camera, shot.t, false).rgb;
    let alone = &still.frame(&shot.camera, shot.t, false).rgb;
    let (mut sums, mut counts) = ([0.0; 2], [0usize; 2]);
    for (i, pixel) in shot.image.data().iter().enumerate() {
        let dynamic = (0..3).any(|c| 255.0 * (whole[c][i] - alone[c][i]).abs() > CHANGE);
        for c in 0..3 {
            let error =
                f64::from(pixel[c]) - f64::from((255.0 * whole[c][i].clamp(0.0, 1.0)).round());
            sums[0] += error * error;
            counts[0] += 1;
            if dynamic {
                sums[1] += error * error;
                counts[1] += 1;
            }
        }
    }
    assert!(
        counts[1] > counts[0] / 50,
        "the object covers a fiftieth of the image at least"
    );
    let db = |k: usize| 10.0 * (255.0f64.powi(2) * counts[k] as f64 / sums[k].max(1e-9)).log10();
    (db(0), db(1))
}

/// Slow enough that images are never a whole repetition of the clip behind its clock, which would
/// count as nothing.
const SLOWLY: f64 = 0.1;
/// Images over which the lag is measured.
const IMAGES: usize = 8;

/// How far the shown images are behind the clock of playback, and what the page says that an image
/// costs, seconds: medians.
fn lag(page: &mut Chromium) -> [f64; 2] {
    page.eval(&format!(
        "(() => {{ const speed = document.querySelector('[data-control=speed]'); speed.value = '{SLOWLY}'; \
         speed.dispatchEvent(new Event('input')); document.querySelector('[data-control=play]').click(); }})()"
    ));
    page.wait_for("minute4d.state().playing && minute4d.state().instant.draw_ms > 0");
    let (mut behind, mut cost, mut shown) = (Vec::new(), 0.0, Vec::new());
    while shown.len() < IMAGES {
        page.eval("new Promise((done) => setTimeout(done, 200))");
        let state = page.eval("minute4d.state()");
        let number = |value: &Value| value.as_f64().unwrap();
        assert_eq!(number(&state["speed"]), SLOWLY);
        let frames =
            (number(&state["clock"]) - number(&state["time"])).rem_euclid((FRAMES - 1) as f64);
        behind.push(frames / (FPS * SLOWLY));
        shown.push(number(&state["time"]));
        shown.dedup();
        // a median of the last images: the first one takes longer
        let parts = ["slice_ms", "readback_ms", "sort_ms", "draw_ms"];
        let now = parts
            .iter()
            .map(|part| number(&state["instant"][part]) / 1000.0)
            .sum();
        // nothing is known just after the page has changed the size of its images
        cost = if now > 0.0 { now } else { cost };
    }
    behind.sort_by(f64::total_cmp);
    [behind[behind.len() / 2], cost]
}

/// How the page is driven while images of it are taken.
const SCRIPTS: [(&str, &str); 3] = [
    (
        "playing at 1x",
        "(() => { const speed = document.querySelector('[data-control=speed]'); speed.value = '1'; speed.dispatchEvent(new Event('input')); \
         minute4d.state().playing || document.querySelector('[data-control=play]').click(); })()",
    ),
    (
        "playing at 2x",
        "(() => { const speed = document.querySelector('[data-control=speed]'); speed.value = '2'; speed.dispatchEvent(new Event('input')); })()",
    ),
    // a hand on the time line, and a camera that moves, both faster than anything can be drawn
    (
        "scrubbing and turning",
        "(() => { const { c2w, fx, fy, cx, cy } = minute4d.state().camera; let i = 0; \
         setInterval(() => { i += 1; const moved = c2w.slice(); moved[3] += 0.1 * Math.sin(i / 20); \
         minute4d.setTime(11.5 + 11 * Math.sin(i / 30)); minute4d.setCamera(moved, fx, fy, cx, cy); }, 10); })()",
    ),
];
const SHOTS: usize = 6;

#[test]
fn playback_images_match_their_time() {
    let Some(chromium) = find_chromium() else {
        return;
    };
    let dir = Scratch::new();
    write_clip(&dir.path("capture"), PAGE_SIZE, FRAMES, FPS);
    dir.succeed("train capture -o out --iterations 300");
    let scene = safetensors::read(&dir.path("out/scene.safetensors"))
        .unwrap()
        .scene;
    let rows: Vec<u32> = (0..scene.splats.n_static() as u32).collect();
    let without = Scene {
        splats: scene.splats.gather(&rows).unwrap(),
        ..scene.clone()
    };
    let level = SimdLevel::detect().unwrap();
    let (mut all, mut still) = (Painter::new(&scene, level), Painter::new(&without, level));

    let mut page = Chromium::open(chromium, &format!("file://{}", dir.at("out/viewer.html")));
    page.eval("minute4d.ready");
    page.resize(PAGE_SIZE.0, PAGE_SIZE.1);
    page.wait_for(&format!("minute4d.state().width === {}", PAGE_SIZE.0));
    // The image that is shown, the one that is drawn, and the one that waits for it.
    let [behind, cost] = lag(&mut page);
    eprintln!("images are {behind:.2} s behind the clock; one costs {cost:.2} s");
    assert!(
        behind <= 3.0 * cost + 0.3,
        "images are {behind} s behind the clock, and one costs {cost} s"
    );
    let mut worst = (f64::INFINITY, f64::INFINITY);
    for (what, script) in SCRIPTS {
        page.eval(script);
        let mut times = Vec::new();
        while times.len() < SHOTS {
            page.eval("new Promise((done) => setTimeout(done, 300))");
            let shot = shot(&mut page);
            let (whole, dynamic) = agreement(&shot, &mut all, &mut still);
            eprintln!(
                "{what}, frame {:.2}: {whole:.1} dB, {dynamic:.1} dB where it is dynamic",
                shot.t
            );
            worst = (worst.0.min(whole), worst.1.min(dynamic));
            times.push(shot.t);
        }
        times.sort_by(f64::total_cmp);
        times.dedup();
        assert!(times.len() >= 5, "{what}: {times:?}");
    }
    assert!(
        worst.0 >= WHOLE_DB && worst.1 >= DYNAMIC_DB,
        "{worst:?} dB at the worst"
    );
}

/// `render` of that scene, with these options.
fn line(options: &str) -> String {
    format!("render '{}' {options}", finished_run())
}

/// Mean absolute difference of two images of one size, levels.
pub fn difference(a: &Path, b: &Path) -> f64 {
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
        ("stabilised", "", 7),
        ("swing", "--seconds 1 --time play", 12),
        ("bullet", "--at 0.2s", 59),
    ] {
        let options = format!("--path {path} --fps 12 --size 51x37 -o {path}.mp4 --json {more}");
        let result = dir.succeed(&line(&options)).result();
        assert_eq!(
            (&result["frames"], &result["width"], &result["height"]),
            (&frames.into(), &51.into(), &37.into()),
            "{path}"
        );
        assert_eq!(
            frames_of(&dir.path(&format!("{path}.mp4"))),
            (frames, (52, 38)),
            "{path}"
        );
    }
    dir.succeed(&line(
        "--path swing --seconds 0.5 --fps 10 --size 33x21 -o png",
    ));
    assert_eq!(dir.count("png"), 5);
    assert_eq!(
        read_rgb(&dir.path("png/00004.png")).unwrap().size(),
        (33, 21)
    );
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
    assert!(
        difference(&one, &dir.path("all/00000.png")) > 1.0,
        "another moment looks different"
    );
    // Twice the size of a crop of the middle is the same view.
    dir.succeed(&line("--path source --at 3 --size 48x48 -o cropped.png"));
    let (small, whole) = (
        read_rgb(&dir.path("cropped.png")).unwrap(),
        read_rgb(&one).unwrap(),
    );
    assert!((0..48).all(|y| {
        (0..48).all(|x| (0..3).all(|c| small[(x, y)][c].abs_diff(whole[(x + 8, y)][c]) <= 2))
    }));
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
    assert_eq!(
        read_rgb(&dir.path("own/00005.png")).unwrap().size(),
        (31, 23)
    );
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
    dir.write(
        "broken.json",
        r#"{"format": "minute4d-path", "version": 1, "keyframes": [{"time_s": 0}]}"#,
    );
    dir.write("there.png", "mine");
    for (options, code, words) in [
        (
            "-o never --path source --degrees 3",
            2,
            &["degrees", "source", "seconds"][..],
        ),
        ("-o never --path train --seconds 3", 2, &["seconds", "at"]),
        ("-o never --path swing --degrees nan", 2, &["degrees"]),
        ("-o never --path swing --seconds -1", 2, &["seconds"]),
        (
            "-o never --path swing --seconds 3600 --fps 240",
            2,
            &["864000 images"],
        ),
        ("-o never --path bullet --seconds 2", 2, &["leaves no time"]),
        ("-o never --path bullet --at 9s", 2, &["9s", "outside"]),
        (
            "-o never --path bullet --at soon",
            2,
            &["\"soon\"", "not a time"],
        ),
        ("-o never --time later", 2, &["\"later\"", "freeze@T"]),
        ("-o never --time freeze@6", 2, &["frame 6", "0 to 5"]),
        ("-o never --path gone.json", 66, &["gone.json"]),
        ("-o never --path spiral", 2, &["spiral", "bullet"]),
        (
            "-o never --path broken.json",
            65,
            &["broken.json", "camera 0", "look_at"],
        ),
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
