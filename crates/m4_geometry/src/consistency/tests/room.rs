//! A made-up clip: a camera walks and turns in a textured room in which a ball flies.

use m4_core::{
    Camera, Capture, CaptureFrame, CompactDepth, CompactMask, Intrinsics, Plane, Se3,
    nalgebra::{Rotation3, Vector3},
};

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

/// The clip with true depth and masks.
pub fn room() -> Capture {
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
            colour(if is_ball {
                p - ball + Vector3::new(7.0, 5.0, 3.0)
            } else {
                p
            })
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
    Capture {
        frames: frames.collect(),
        time_frames: FRAMES,
        duration_s: None,
        metric: true,
        tracks: None,
    }
}
