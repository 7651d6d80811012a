//! Writes a generated clip of any length, for measuring what a long one costs:
//!
//! ```text
//! cargo run --release -p minute4d_cli --no-default-features --example long_clip -- FOLDER [FRAMES] [WIDTH]
//! /usr/bin/time -v target/release/minute4d geometry FOLDER -o CAPTURE
//! ```
//!
//! A camera walks along an endless wall with boxes before it, and a box that rises and falls goes with it. By default 1,500
//! frames of 320x240.
#![forbid(unsafe_code)]

use anyhow::{Context, Result, ensure};
use minute4d::io::image::write_rgb;
use minute4d::math::nalgebra::Vector3;
use minute4d::math::{Se3, exp_so3};
use minute4d::scene::{Camera, Intrinsics, Plane};
use std::path::PathBuf;

/// Way of the camera from frame to frame; the wall is 6 away.
const STEP: f64 = 0.02;

/// Brightness of a surface: waves of many lengths.
fn texture(x: f64, y: f64, surface: f64) -> f64 {
    let wave = |k: i32| {
        let turn = 2.4 * f64::from(k) + surface;
        let frequency = 2.0 * 1.35_f64.powi(k);
        let phase = (x * turn.cos() + y * turn.sin()) * frequency;
        (phase + 1.7 * f64::from(k) * surface).sin() / 1.1_f64.powi(k)
    };
    (0..9).map(wave).sum()
}

fn colour(x: f64, y: f64, surface: f64) -> [u8; 3] {
    [0.0, 0.3, 0.6].map(|s| (128.0 + 26.0 * texture(x + 0.1 * s, y, surface + s)).clamp(0.0, 255.0) as u8)
}

/// What pixel `(u, v)` of `camera` sees in frame `i`.
fn see(camera: &Camera, i: usize, u: f64, v: f64) -> [u8; 3] {
    let centre = camera.centre();
    let ray = camera.unproject(u, v, 1.0) - centre;
    let hit = |z: f64| centre + ray * ((z - centre.z) / ray.z);
    let time = i as f64;
    // What moves: as fast as the camera on the whole, and to and fro.
    let (mx, my) = (STEP * time + 0.5 * (0.05 * time).sin(), 0.2 + 0.5 * (0.13 * time).sin());
    let p = hit(2.5);
    if (p.x - mx).abs() < 0.35 && (p.y - my).abs() < 0.35 {
        return colour(p.x - mx, p.y - my, 5.0);
    }
    for (surface, (z, period)) in [(3.2, 4.1), (4.4, 2.9)].into_iter().enumerate() {
        let p = hit(z);
        if p.x.rem_euclid(period) < 1.1 && p.y > -0.1 {
            return colour(p.x, p.y, 1.0 + surface as f64);
        }
    }
    let p = hit(6.0);
    colour(p.x, p.y, 3.0)
}

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().context("which folder is the clip to be written to?")?);
    let mut number = |usual: usize| arguments.next().map_or(Ok(usual), |a| a.parse());
    let (frames, width) = (number(1500)?, number(320)?);
    ensure!(frames >= 2 && width >= 64, "at least 2 frames, 64 pixels wide");
    let height = width * 3 / 4;
    std::fs::create_dir_all(&folder)?;
    for i in 0..frames {
        let time = i as f64;
        let turn = Vector3::new(0.01 * (0.07 * time).sin(), 0.06 * (0.021 * time).sin(), 0.0);
        let camera = Camera {
            intrinsics: Intrinsics::centred(width, height, 0.94 * width as f64),
            c2w: Se3 {
                rotation: exp_so3(&turn),
                translation: Vector3::new(STEP * time, 0.05 * (0.09 * time).sin(), 0.3 * (0.013 * time).sin()),
            },
        };
        let picture = Plane::from_fn(width, height, |x, y| see(&camera, i, x as f64, y as f64));
        write_rgb(&folder.join(format!("{i:05}.png")), &picture)?;
    }
    Ok(())
}
