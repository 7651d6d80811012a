//! On a made-up room, and on a benchmark scene where it is present: every convention error is reported, and correct data is not.

use super::{Cause, Verdict, check, fixed};
use crate::classical::dense::InverseSearch;
use m4_core::{
    Camera, Capture, CaptureFrame, CompactDepth, CompactMask, Intrinsics, Plane, Se3, Silent,
    nalgebra::{Rotation3, Vector3},
};
use m4_io::capture::{self, CaptureOptions, Split};

const SIZE: (usize, usize) = (240, 180);
const FRAMES: usize = 32;
/// Half the sides of the room, which the camera starts in the middle of.
const HALF: [f64; 3] = [3.0, 2.0, 6.0];
const RADIUS: f64 = 0.6;

/// What the ray of a pixel (centre of the first: 0, 0) meets from inside the room: z-depth along it, place, whether it is the ball.
fn meet(camera: &Camera, ball: Vector3<f64>, u: f64, v: f64) -> (f64, Vector3<f64>, bool) {
    let (o, d) = (camera.centre(), camera.unproject(u, v, 1.0) - camera.centre());
    let wall = |k: usize| (HALF[k].copysign(d[k]) - o[k]) / d[k];
    let room = (0..3).map(wall).fold(f64::INFINITY, f64::min);
    let (b, c) = (d.dot(&(o - ball)), (o - ball).norm_squared() - RADIUS * RADIUS);
    let inside = b * b - d.norm_squared() * c;
    if inside > 0.0 {
        let z = (-b - inside.sqrt()) / d.norm_squared();
        if z > 0.0 && z < room {
            return (z, o + z * d, true);
        }
    }
    (room, o + room * d, false)
}

/// Smooth colours of several sizes, no two places alike.
fn colour(p: Vector3<f64>) -> [u8; 3] {
    std::array::from_fn(|k| {
        let phase = 1.7 * k as f64;
        let wave = |size: f64, a: [f64; 3]| {
            ((p.dot(&Vector3::from(a)) + phase) / size).sin()
                * ((p.dot(&Vector3::new(a[2], -a[0], a[1])) - phase) / size).cos()
        };
        let sum = 0.4 * wave(0.7, [1.0, 0.3, 0.6])
            + 0.35 * wave(0.29, [-0.4, 1.0, 0.5])
            + 0.25 * wave(0.13, [0.5, -0.7, 1.0]);
        (127.5 + 120.0 * sum).round() as u8
    })
}

/// A made-up clip with true depth and masks: a camera walks and turns in a textured room in which a ball flies.
fn room() -> Capture {
    let (w, h) = SIZE;
    let frames = (0..FRAMES).map(|i| {
        let s = i as f64 / (FRAMES - 1) as f64;
        let turn = Vector3::new(0.06 * (4.0 * s).sin(), 0.5 * s - 0.25, 0.02 * s);
        let camera = Camera {
            intrinsics: Intrinsics::centred(w, h, 200.0),
            c2w: Se3 {
                rotation: *Rotation3::from_scaled_axis(turn).matrix(),
                translation: Vector3::new(0.9 * s - 0.3, 0.2 * (3.0 * s).sin(), 1.6 * s - 2.0),
            },
        };
        let ball = Vector3::new(1.6 - 3.0 * s, 0.3 - 0.8 * s, 2.5);
        let met = Plane::from_fn(w, h, |x, y| meet(&camera, ball, x as f64, y as f64));
        let rgb = Plane::from_fn(w, h, |x, y| {
            let (_, p, is_ball) = met[(x, y)];
            // its texture flies with it
            colour(if is_ball { p - ball + Vector3::new(7.0, 5.0, 3.0) } else { p })
        });
        CaptureFrame {
            name: format!("{i}.png"),
            camera,
            t: i as f64,
            rgb,
            depth: Some(CompactDepth::from(met.map(|m| m.0 as f32))),
            mask: Some(CompactMask::from_fn(w, h, |x, y| met[(x, y)].2)),
            motion: None,
            instances: None,
            camera_index: None,
        }
    });
    Capture { frames: frames.collect(), time_frames: FRAMES, duration_s: None, metric: true, tracks: None }
}

/// The clips to judge, by name.
fn scenes() -> Vec<(&'static str, Capture)> {
    let mut all = vec![("room", room())];
    if let Some(path) = m4_testkit::shared("bench/quad-1") {
        let mut read = capture::read(&path, Split::Train, &CaptureOptions::default(), &Silent).unwrap();
        read.frames.truncate(32);
        all.push(("quad-1", read));
    }
    all
}

fn misread(mut capture: Capture, wrong: &dyn Fn(&mut Camera)) -> Capture {
    capture.frames.iter_mut().for_each(|f| wrong(&mut f.camera));
    capture
}

fn opengl(camera: &mut Camera) {
    camera.c2w.rotation.column_mut(1).neg_mut();
    camera.c2w.rotation.column_mut(2).neg_mut();
}

fn inverse(camera: &mut Camera) {
    camera.c2w = camera.c2w.inverse();
}

#[test]
fn common_convention_errors_are_detected() {
    for (name, truth) in scenes() {
        println!("{name}");
        tell_all(truth);
    }
}

fn tell_all(truth: Capture) {
    let flow = InverseSearch;
    let said = |capture: &Capture| {
        let report = check(capture, &flow, &Silent).unwrap();
        println!("{report:?}");
        report
    };
    let good = said(&truth);
    assert_eq!((good.verdict, good.causes.as_slice()), (Verdict::Good, &[][..]));
    assert!(good.samples > 10_000 && good.error_px.unwrap() < 0.5 && good.error_px.unwrap() > 0.0);
    assert!(good.depth_error.unwrap() < 0.02);

    let mut millimetres = truth.clone();
    for frame in &mut millimetres.frames {
        let depth = frame.depth.take().unwrap().to_map();
        frame.depth = Some(CompactDepth::from(depth.map(|z| 1000.0 * z)));
    }
    let mut masked = truth.clone();
    for frame in &mut masked.frames {
        let mask = frame.mask.take().unwrap().to_mask();
        frame.mask = Some(CompactMask::from(&mask.map(|m| 255 - m)));
    }
    let shifted = |px: f64| {
        misread(truth.clone(), &|c| {
            c.intrinsics.cx += px;
            c.intrinsics.cy += px;
        })
    };
    for (wrong, causes) in [
        (misread(truth.clone(), &opengl), vec![Cause::Axes]),
        (misread(truth.clone(), &inverse), vec![Cause::Inverted]),
        (misread(misread(truth.clone(), &opengl), &inverse), vec![Cause::Inverted, Cause::Axes]),
        (millimetres, vec![Cause::DepthUnit { factor: 1e-3 }]),
        (masked, vec![Cause::Masks]),
        (shifted(-0.5), vec![Cause::PixelCentre { shift_px: [0.5; 2] }]),
        (shifted(0.5), vec![Cause::PixelCentre { shift_px: [-0.5; 2] }]),
    ] {
        let report = said(&wrong);
        assert_eq!(report.causes, causes);
        let mended = said(&fixed(wrong, &causes));
        if matches!(causes[0], Cause::PixelCentre { .. }) {
            assert!(mended.causes.is_empty());
        } else {
            assert_eq!((report.verdict, mended.verdict), (Verdict::Bad, Verdict::Good), "{causes:?}");
        }
    }
}

#[test]
fn poses_without_depth_are_checked_too() {
    for (name, truth) in scenes() {
        println!("{name}");
        tell_without_depth(truth);
    }
}

fn tell_without_depth(mut truth: Capture) {
    truth.frames.iter_mut().for_each(|f| f.depth = None);
    let flow = InverseSearch;
    let said = |capture: &Capture| check(capture, &flow, &Silent).unwrap();
    let good = said(&truth);
    println!("{good:?}");
    assert_eq!((good.verdict, good.depth_error), (Verdict::Good, None));
    assert_eq!(said(&misread(truth.clone(), &inverse)).causes, [Cause::Inverted]);
    assert_eq!(said(&misread(truth, &opengl)).causes, [Cause::Axes]);
}

#[test]
fn static_camera_gives_no_verdict() {
    let mut still = room();
    still.frames = vec![still.frames[0].clone(); 8];
    let report = check(&still, &InverseSearch, &Silent).unwrap();
    assert_eq!((report.verdict, report.causes.len()), (Verdict::Unknown, 0));
}
