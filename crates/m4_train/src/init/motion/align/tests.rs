use super::{Extent, NARROW, Observed, Prior, Rigid, WIDE, align};
use crate::init::motion::pieces::pieces;
use m4_core::{Camera, CaptureFrame, CompactMask, Intrinsics, Plane, Se3};

const SIZE: (usize, usize) = (160, 120);
const DEPTH: f64 = 2.0;
const ROUNDS: [Extent; 2] = [WIDE, NARROW];

/// A textured wall, dynamic but for its left quarter, whose pixel `(x, y)` shows what is at
/// `back(x, y)`, by that much `light`.
fn frame(back: impl Fn(f64, f64) -> [f64; 2], contrast: f64, light: f64) -> CaptureFrame {
    let texture = |x: f64, y: f64| {
        let wave = |a: f64, b: f64, c: f64| {
            0.5 + contrast * (0.25 * (a * x + b * y).sin() + 0.25 * (b * x - a * y + c).cos())
        };
        [
            wave(0.5, 0.2, 0.0),
            wave(0.3, -0.45, 1.0),
            wave(0.15, 0.6, 2.0),
        ]
    };
    CaptureFrame {
        name: String::new(),
        camera: Camera {
            intrinsics: Intrinsics::centred(SIZE.0, SIZE.1, 140.0),
            c2w: Se3::identity(),
        },
        t: 0.0,
        rgb: Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            let [u, v] = back(x as f64, y as f64);
            texture(u, v).map(|v| (255.0 * light * v).round() as u8)
        }),
        depth: Some(Plane::filled(SIZE.0, SIZE.1, DEPTH as f32).into()),
        mask: Some(CompactMask::from_fn(SIZE.0, SIZE.1, |x, _| x >= 40)),
        motion: None,
        instances: None,
        camera_index: None,
        distance_sigma: None,
    }
}

fn still(contrast: f64) -> CaptureFrame {
    frame(|x, y| [x, y], contrast, 1.0)
}

/// Places of the wall inside the image.
fn places(frame: &CaptureFrame) -> Vec<[f32; 3]> {
    let pixels = (0..192).map(|k| [f64::from(56 + 6 * (k % 16)), f64::from(24 + 7 * (k / 16))]);
    let place = |[u, v]: [f64; 2]| {
        let q = frame.camera.unproject(u, v, DEPTH);
        [q.x as f32, q.y as f32, q.z as f32]
    };
    pixels.map(place).collect()
}

/// The median and the largest distance of nodes, aligned from no motion, from `forward`, pixels;
/// and the largest error of depth, share.
fn errors(
    from: &CaptureFrame,
    to: &CaptureFrame,
    forward: impl Fn(f64, f64) -> [f64; 2],
) -> [f32; 3] {
    let places = places(from);
    let (pieces, chosen) = pieces(&Observed::new(from).unwrap(), &places, 6.0).unwrap();
    assert_eq!(chosen.len(), pieces.nodes.len());
    let still: Vec<Rigid> = pieces
        .nodes
        .iter()
        .map(|n| Rigid::shift(n.place.into(), n.place.into()))
        .collect();
    let prior = Prior {
        depth: 0.004,
        apart_px: 0.5,
        step_px: 1.0,
    };
    let motion = align(
        &pieces,
        &Observed::new(to).unwrap(),
        &still,
        prior,
        &ROUNDS.map(|e| [e; 6]).concat(),
    );
    let (mut off, mut depth) = (Vec::new(), 0.0f32);
    for (node, motion) in pieces.nodes.iter().zip(&motion) {
        let (at, _) = from.camera.project(&node.place.cast::<f64>());
        let ([u, v], z) = to.camera.project(&motion.moved(&node.place).cast::<f64>());
        let want = forward(at[0], at[1]);
        off.push((u - want[0]).hypot(v - want[1]) as f32);
        depth = depth.max((z / DEPTH - 1.0).abs() as f32);
    }
    let most = off.iter().fold(0.0f32, |a, &b| a.max(b));
    [m4_core::median(&mut off).unwrap(), most, depth]
}

#[test]
fn a_guess_that_is_a_pixel_off_becomes_exact_to_a_tenth_in_dimmer_light() {
    let shifted = frame(|x, y| [x - 0.8, y + 0.6], 1.0, 0.7);
    let [median, most, depth] = errors(&still(1.0), &shifted, |x, y| [x + 0.8, y - 0.6]);
    assert!(
        median < 0.1 && most < 0.3 && depth < 0.002,
        "{median} {most} px, {depth}"
    );
    let turned = |angle: f64| {
        let (sin, cos) = angle.sin_cos();
        move |x: f64, y: f64| {
            let (x, y) = (x - 100.0, y - 60.0);
            [100.0 + cos * x - sin * y, 60.0 + sin * x + cos * y]
        }
    };
    let [median, most, depth] = errors(&still(1.0), &frame(turned(-0.02), 1.0, 0.7), turned(0.02));
    assert!(
        median < 0.1 && most < 0.3 && depth < 0.002,
        "{median} {most} px, {depth}"
    );
}

#[test]
fn a_plain_surface_keeps_its_guess() {
    let [_, most, depth] = errors(&still(0.0), &still(0.0), |x, y| [x, y]);
    assert!(most < 1e-3 && depth < 1e-4, "{most} px, {depth}");
    let [_, most, _] = errors(&still(0.0), &frame(|x, y| [x, y], 0.0, 0.6), |x, y| [x, y]);
    assert!(most < 0.05, "{most} px");
}

#[test]
fn what_shows_nothing_moves_nothing() {
    let from = still(1.0);
    let without = |depth: bool| match depth {
        true => CaptureFrame {
            depth: None,
            ..from.clone()
        },
        false => CaptureFrame {
            mask: None,
            ..from.clone()
        },
    };
    assert!(Observed::new(&without(true)).is_none() && Observed::new(&without(false)).is_none());
    let empty = CaptureFrame {
        mask: Some(CompactMask::from_fn(SIZE.0, SIZE.1, |_, _| false)),
        ..from.clone()
    };
    assert!(pieces(&Observed::new(&empty).unwrap(), &[], 6.0).is_none());
    let [_, most, depth] = errors(&from, &empty, |x, y| [x, y]);
    assert!(most < 1e-3 && depth < 1e-4, "{most} px, {depth}");
    let away = Se3 {
        translation: [0.0, 0.0, 9.0].into(),
        ..Se3::identity()
    };
    let behind = CaptureFrame {
        camera: Camera {
            c2w: away,
            ..from.camera
        },
        ..from.clone()
    };
    let (pieces, _) = pieces(&Observed::new(&from).unwrap(), &places(&from), 6.0).unwrap();
    let still: Vec<Rigid> = pieces
        .nodes
        .iter()
        .map(|n| Rigid::shift(n.place.into(), n.place.into()))
        .collect();
    let prior = Prior {
        depth: 0.004,
        apart_px: 0.5,
        step_px: 1.0,
    };
    let motion = align(
        &pieces,
        &Observed::new(&behind).unwrap(),
        &still,
        prior,
        &ROUNDS.map(|e| [e; 6]).concat(),
    );
    assert!(motion.iter().all(|m| (m.to - m.from).norm() < 1e-3));
}
