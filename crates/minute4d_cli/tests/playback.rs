//! What the page shows while it plays: every image belongs to one instant.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{Scratch, write_clip};
use m4_testkit::{Chromium, find_chromium};
use minute4d::core::{
    Camera, Intrinsics, RgbImage, Scene, Se3,
    nalgebra::{Matrix3, Vector3},
};
use minute4d::io::scene::safetensors;
use minute4d::kernels::SimdLevel;
use minute4d::render::Painter;
use serde_json::Value;

/// Pixels of the clip, and of the window that it is played in: nothing is scaled.
const SIZE: (usize, usize) = (320, 240);
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
    let c2w: Vec<f64> = state["camera"]["c2w"].as_array().unwrap().iter().map(number).collect();
    let k = |name: &str| number(&state["camera"][name]);
    let size = |name: &str| number(&state[name]) as usize;
    let (width, height) = (size("width"), size("height"));
    let camera = Camera {
        intrinsics: Intrinsics { fx: k("fx"), fy: k("fy"), cx: k("cx"), cy: k("cy"), width, height },
        c2w: Se3 {
            rotation: Matrix3::from_fn(|row, column| c2w[4 * row + column]),
            translation: Vector3::new(c2w[3], c2w[7], c2w[11]),
        },
    };
    let rgba: Vec<u8> = state["rgba"].as_array().unwrap().iter().map(|v| v.as_u64().unwrap() as u8).collect();
    Shot {
        t: number(&state["time"]),
        camera,
        image: RgbImage::from_fn(width, height, |x, y| std::array::from_fn(|c| rgba[4 * (y * width + x) + c])),
    }
}

/// Agreement of an image with our renderer at the time and the camera that the page reports, dB: over all of it,
/// and where dynamic splats change it.
fn agreement(shot: &Shot, all: &mut Painter<'_>, still: &mut Painter<'_>) -> (f64, f64) {
    let whole = &all.frame(&shot.camera, shot.t, false).rgb;
    let alone = &still.frame(&shot.camera, shot.t, false).rgb;
    let (mut sums, mut counts) = ([0.0; 2], [0usize; 2]);
    for (i, pixel) in shot.image.data().iter().enumerate() {
        let dynamic = (0..3).any(|c| 255.0 * (whole[c][i] - alone[c][i]).abs() > CHANGE);
        for c in 0..3 {
            let error = f64::from(pixel[c]) - f64::from((255.0 * whole[c][i].clamp(0.0, 1.0)).round());
            sums[0] += error * error;
            counts[0] += 1;
            if dynamic {
                sums[1] += error * error;
                counts[1] += 1;
            }
        }
    }
    assert!(counts[1] > counts[0] / 50, "the object covers a fiftieth of the image at least");
    let db = |k: usize| 10.0 * (255.0f64.powi(2) * counts[k] as f64 / sums[k].max(1e-9)).log10();
    (db(0), db(1))
}

/// How the page is driven while images of it are taken.
const SCRIPTS: [(&str, &str); 3] = [
    ("playing at 1x", "minute4d.state().playing || document.querySelector('[data-control=play]').click()"),
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
    let Some(chromium) = find_chromium() else { return };
    let dir = Scratch::new();
    write_clip(&dir.path("capture"), SIZE, FRAMES, FPS);
    dir.succeed("train capture -o out --iterations 300");
    let scene = safetensors::read(&dir.path("out/scene.safetensors")).unwrap().scene;
    let kept: Vec<u32> = (0..scene.splats.n_static() as u32).collect();
    let without = Scene { splats: scene.splats.gather(&kept).unwrap(), ..scene.clone() };
    let level = SimdLevel::detect().unwrap();
    let (mut all, mut still) = (Painter::new(&scene, level), Painter::new(&without, level));

    let mut page = Chromium::open(chromium, &format!("file://{}", dir.at("out/viewer.html")));
    page.eval("minute4d.ready");
    page.resize(SIZE.0, SIZE.1);
    page.wait_for(&format!("minute4d.state().width === {}", SIZE.0));
    let mut worst = (f64::INFINITY, f64::INFINITY);
    for (what, script) in SCRIPTS {
        page.eval(script);
        let mut times = Vec::new();
        while times.len() < SHOTS {
            page.eval("new Promise((done) => setTimeout(done, 300))");
            let shot = shot(&mut page);
            let (whole, dynamic) = agreement(&shot, &mut all, &mut still);
            eprintln!("{what}, frame {:.2}: {whole:.1} dB, {dynamic:.1} dB where it is dynamic", shot.t);
            worst = (worst.0.min(whole), worst.1.min(dynamic));
            times.push(shot.t);
        }
        times.sort_by(f64::total_cmp);
        times.dedup();
        assert!(times.len() >= 5, "{what}: {times:?}");
    }
    assert!(worst.0 >= WHOLE_DB && worst.1 >= DYNAMIC_DB, "{worst:?} dB at the worst");
}
