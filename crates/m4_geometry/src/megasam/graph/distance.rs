//! How far the pixels of one frame move to be seen in another.
//!
//! `beta` times the mean motion, plus `1 - beta` times the mean motion were the camera not to turn: rotation
//! alone makes a pair look far, though it tells nothing about depth.

use crate::dba::{Geometry, MIN_DEPTH, project};
use fearless_simd::Level;
use m4_core::dispatch;
use m4_core::{Real, Se3};
use rayon::prelude::*;

/// The distance of frames that hardly share a view.
pub const FAR: f64 = 1000.0;

/// Least share of valid pixels of a pair that has a distance.
const LEAST_VALID: f64 = 0.75;

/// Pixels of one task of the inner loop.
const LANES: usize = 16;

/// Sums of one pair.
#[derive(Default, Clone, Copy)]
struct Sums {
    motion: f64,
    valid: f64,
    total: f64,
}

impl Sums {
    fn distance(self) -> f64 {
        if self.valid / (self.total + 1e-8) < LEAST_VALID { FAR } else { self.motion / self.valid }
    }
}

/// Directed distance from `i` to `j` in pixels of the grid, [`FAR`] when fewer than three quarters of the pixels
/// lie before the target's camera: plain f64.
#[must_use]
pub fn frame_distance_reference<T: Real>(geometry: &Geometry<T>, i: usize, j: usize, beta: f64) -> f64 {
    let g = geometry.relative(i, j);
    let still = Se3 { translation: g.translation, ..Se3::identity() };
    let mut sums = Sums::default();
    for (motion, share) in [(g, beta), (still, 1.0 - beta)] {
        for (n, d) in geometry.disparity[i].iter().enumerate() {
            let (u, v) = ((n % geometry.grid.width) as f64, (n / geometry.grid.width) as f64);
            let p = project(&motion, &geometry.lens, 1.0, u, v, d.f64());
            sums.total += share;
            if p.z > MIN_DEPTH {
                sums.motion += share * (p.pixel.x - u).hypot(p.pixel.y - v);
                sums.valid += share;
            }
        }
    }
    sums.distance()
}

/// Rays of the grid, padded to whole lanes, and the pixels' own positions.
struct Rays {
    x: Vec<f32>,
    y: Vec<f32>,
    u: Vec<f32>,
    v: Vec<f32>,
}

impl Rays {
    fn new(geometry: &Geometry<f32>) -> Self {
        let (width, len) = (geometry.grid.width, geometry.grid.len());
        let lens = &geometry.lens;
        let u: Vec<f32> = (0..len).map(|n| (n % width) as f32).collect();
        let v: Vec<f32> = (0..len).map(|n| (n / width) as f32).collect();
        Self {
            x: u.iter().map(|&u| ((f64::from(u) - lens.cx) / lens.fx) as f32).collect(),
            y: v.iter().map(|&v| ((f64::from(v) - lens.cy) / lens.fy) as f32).collect(),
            u,
            v,
        }
    }

    #[inline(always)]
    fn sum(&self, g: &Se3<f32>, focal: [f32; 2], centre: [f32; 2], disparity: &[f32]) -> (f64, f64) {
        let (r, t) = (&g.rotation, &g.translation);
        let (mut motion, mut valid) = (0.0_f64, 0.0_f64);
        for start in (0..disparity.len()).step_by(LANES) {
            let count = (disparity.len() - start).min(LANES);
            let load = |plane: &[f32]| {
                let mut lane = [0.0_f32; LANES];
                lane[..count].copy_from_slice(&plane[start..start + count]);
                lane
            };
            let (rx, ry, u, v, d) = (load(&self.x), load(&self.y), load(&self.u), load(&self.v), load(disparity));
            let (mut length, mut ok) = ([0.0_f32; LANES], [0.0_f32; LANES]);
            for l in 0..LANES {
                let x = r[(0, 0)] * rx[l] + r[(0, 1)] * ry[l] + r[(0, 2)] + t[0] * d[l];
                let y = r[(1, 0)] * rx[l] + r[(1, 1)] * ry[l] + r[(1, 2)] + t[1] * d[l];
                let z = r[(2, 0)] * rx[l] + r[(2, 1)] * ry[l] + r[(2, 2)] + t[2] * d[l];
                let seen = z > MIN_DEPTH as f32 && l < count;
                let iz = 1.0 / if seen { z } else { 1.0 };
                let (du, dv) = (focal[0] * x * iz + centre[0] - u[l], focal[1] * y * iz + centre[1] - v[l]);
                let on = if seen { 1.0 } else { 0.0 };
                length[l] = (du * du + dv * dv).sqrt() * on;
                ok[l] = on;
            }
            let (mut a, mut b) = (0.0_f32, 0.0_f32);
            for l in 0..LANES {
                a += length[l];
                b += ok[l];
            }
            motion += f64::from(a);
            valid += f64::from(b);
        }
        (motion, valid)
    }

    fn distance(&self, geometry: &Geometry<f32>, i: usize, j: usize, beta: f64, level: Level) -> f64 {
        let g = geometry.relative(i, j).cast::<f32>();
        let still = Se3 { translation: g.translation, ..Se3::identity() };
        let lens = geometry.lens;
        let (focal, centre) = ([lens.fx as f32, lens.fy as f32], [lens.cx as f32, lens.cy as f32]);
        let disparity = geometry.disparity[i].as_slice();
        let mut sums = Sums::default();
        for (motion, share) in [(g, beta), (still, 1.0 - beta)] {
            let (length, valid) = dispatch!(level, _s => self.sum(&motion, focal, centre, disparity));
            sums.motion += share * length;
            sums.valid += share * valid;
            sums.total += share * disparity.len() as f64;
        }
        sums.distance()
    }
}

/// As [`frame_distance_reference`], in f32 with sums in f64.
#[must_use]
pub fn frame_distance(geometry: &Geometry<f32>, i: usize, j: usize, beta: f64) -> f64 {
    Rays::new(geometry).distance(geometry, i, j, beta, Level::new())
}

/// The mean of both directions for every pair given, pixels of the grid.
#[must_use]
pub fn symmetric_distances(geometry: &Geometry<f32>, pairs: &[(usize, usize)], beta: f64) -> Vec<f64> {
    let (rays, level) = (Rays::new(geometry), Level::new());
    pairs
        .par_iter()
        .map(|&(i, j)| 0.5 * (rays.distance(geometry, i, j, beta, level) + rays.distance(geometry, j, i, beta, level)))
        .collect()
}
