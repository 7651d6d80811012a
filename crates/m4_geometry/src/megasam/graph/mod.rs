//! Which frames are compared with which.
//!
//! ```text
//! Geometry -> distance (how far pixels move between two frames)
//!          -> selection (candidate pairs, suppression around existing edges, greedy choice)
//!          -> FactorGraph (active, retired and rejected edges; ages; renumbering when a keyframe goes)
//! ```
//!
//! Source: docs/spec/front-end.md 1.5; DROID-SLAM (Teed and Deng 2021), section 3.1. Indices are
//! those of keyframes, poses map world to camera, positions are pixels of the grid (see
//! [`crate::dba`]).

mod factor_graph;

use crate::dba::{Geometry, MIN_DEPTH, project};
pub(crate) use factor_graph::projected_planes;
pub use factor_graph::{EdgeChanges, EdgeId, EdgeKey, FactorGraph, GraphEdge};
use fearless_simd::Level;
use m4_core::{Real, Se3, dispatch};
use rayon::prelude::*;

/// Which pairs are candidates and how many are taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProximitySettings {
    /// First source of a candidate pair.
    pub first_source: usize,
    /// First target of a candidate pair.
    pub first_target: usize,
    /// Frames this close in time are not candidates; those up to one further are always joined.
    pub radius: usize,
    /// How far around an edge others are suppressed, in steps of frames.
    pub suppression: usize,
    /// Greatest distance, pixels of the grid.
    pub threshold_px: f64,
    /// Share of the full motion in the distance, the rest being motion without rotation.
    pub beta: f64,
    /// Most edges that one choice makes.
    pub max_factors: usize,
}

/// All ordered pairs of different frames of `from..to` at most `radius` apart, by source and then
/// target.
#[must_use]
pub fn neighbourhood(from: usize, to: usize, radius: usize) -> Vec<(usize, usize)> {
    (from..to)
        .flat_map(|i| (from..to).map(move |j| (i, j)))
        .filter(|&(i, j)| i != j && i.abs_diff(j) <= radius)
        .collect()
}

/// Candidate pairs that are not open any more.
struct Open<'a> {
    settings: &'a ProximitySettings,
    frames: usize,
    open: Vec<bool>,
}

impl Open<'_> {
    fn at(&self, i: usize, j: usize) -> Option<usize> {
        let s = self.settings;
        let inside = (s.first_source..self.frames).contains(&i)
            && (s.first_target..self.frames).contains(&j);
        inside.then(|| (i - s.first_source) * (self.frames - s.first_target) + j - s.first_target)
    }

    fn close(&mut self, i: usize, j: usize) {
        if let Some(k) = self.at(i, j) {
            self.open[k] = false;
        }
    }

    /// Closes all pairs around an edge: as many steps away as the suppression says, fewer for short
    /// edges.
    fn suppress(&mut self, i: usize, j: usize) {
        let reach = i
            .abs_diff(j)
            .saturating_sub(2)
            .min(self.settings.suppression);
        for i1 in i.saturating_sub(reach)..=i + reach {
            let left = reach - i.abs_diff(i1);
            for j1 in j.saturating_sub(left)..=j + left {
                self.close(i1, j1);
            }
        }
    }
}

/// The edges to add to a graph of `frames` frames that has the edges `existing`: neighbours in
/// time, then pairs by rising distance, both directions of each. `distances` gives the distance of
/// every pair it is asked for. Some may exist already.
pub fn select_proximity(
    frames: usize,
    existing: &[(usize, usize)],
    settings: &ProximitySettings,
    distances: impl FnOnce(&[(usize, usize)]) -> Vec<f64>,
) -> Vec<(usize, usize)> {
    let (s, columns) = (settings, frames.saturating_sub(settings.first_target));
    let rows = frames.saturating_sub(s.first_source);
    let mut candidates = Open {
        settings,
        frames,
        open: vec![true; rows * columns],
    };
    for &(i, j) in existing {
        candidates.suppress(i, j);
    }
    let mut edges = Vec::new();
    for i in s.first_source..frames {
        for j in i.saturating_sub(s.radius + 1)..i {
            edges.push((i, j));
            edges.push((j, i));
            candidates.close(i, j);
        }
    }
    let pairs: Vec<(usize, usize)> = (s.first_source..frames)
        .flat_map(|i| (s.first_target..frames).map(move |j| (i, j)))
        .filter(|&(i, j)| {
            i >= j + s.radius && candidates.at(i, j).is_some_and(|k| candidates.open[k])
        })
        .collect();
    let distance = distances(&pairs);
    let mut order: Vec<usize> = (0..pairs.len())
        .filter(|&k| distance[k] <= s.threshold_px.min(100.0))
        .collect();
    order.sort_by(|&a, &b| distance[a].total_cmp(&distance[b]));
    for k in order {
        let (i, j) = pairs[k];
        if !candidates.at(i, j).is_some_and(|k| candidates.open[k]) {
            continue;
        }
        if edges.len() > s.max_factors {
            break;
        }
        edges.push((i, j));
        edges.push((j, i));
        candidates.suppress(i, j);
    }
    edges
}

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
        if self.valid / (self.total + 1e-8) < LEAST_VALID {
            FAR
        } else {
            self.motion / self.valid
        }
    }
}

/// Directed distance from `i` to `j` in pixels of the grid, [`FAR`] when fewer than three quarters
/// of the pixels lie before the target's camera: plain f64.
#[must_use]
pub fn frame_distance_reference<T: Real>(
    geometry: &Geometry<T>,
    i: usize,
    j: usize,
    beta: f64,
) -> f64 {
    let g = geometry.relative(i, j);
    let still = Se3 {
        translation: g.translation,
        ..Se3::identity()
    };
    let mut sums = Sums::default();
    for (motion, share) in [(g, beta), (still, 1.0 - beta)] {
        for (n, d) in geometry.disparity[i].iter().enumerate() {
            let (u, v) = (
                (n % geometry.grid.width) as f64,
                (n / geometry.grid.width) as f64,
            );
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
            x: u.iter()
                .map(|&u| ((f64::from(u) - lens.cx) / lens.fx) as f32)
                .collect(),
            y: v.iter()
                .map(|&v| ((f64::from(v) - lens.cy) / lens.fy) as f32)
                .collect(),
            u,
            v,
        }
    }

    #[inline(always)]
    fn sum(
        &self,
        g: &Se3<f32>,
        focal: [f32; 2],
        centre: [f32; 2],
        disparity: &[f32],
    ) -> (f64, f64) {
        let (r, t) = (&g.rotation, &g.translation);
        let (mut motion, mut valid) = (0.0_f64, 0.0_f64);
        for start in (0..disparity.len()).step_by(LANES) {
            let count = (disparity.len() - start).min(LANES);
            let load = |plane: &[f32]| {
                let mut lane = [0.0_f32; LANES];
                lane[..count].copy_from_slice(&plane[start..start + count]);
                lane
            };
            let (rx, ry, u, v, d) = (
                load(&self.x),
                load(&self.y),
                load(&self.u),
                load(&self.v),
                load(disparity),
            );
            let (mut length, mut ok) = ([0.0_f32; LANES], [0.0_f32; LANES]);
            for l in 0..LANES {
                let x = r[(0, 0)] * rx[l] + r[(0, 1)] * ry[l] + r[(0, 2)] + t[0] * d[l];
                let y = r[(1, 0)] * rx[l] + r[(1, 1)] * ry[l] + r[(1, 2)] + t[1] * d[l];
                let z = r[(2, 0)] * rx[l] + r[(2, 1)] * ry[l] + r[(2, 2)] + t[2] * d[l];
                let visible = z > MIN_DEPTH as f32 && l < count;
                let iz = 1.0 / if visible { z } else { 1.0 };
                let (du, dv) = (
                    focal[0] * x * iz + centre[0] - u[l],
                    focal[1] * y * iz + centre[1] - v[l],
                );
                let on = if visible { 1.0 } else { 0.0 };
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

    fn distance(
        &self,
        geometry: &Geometry<f32>,
        i: usize,
        j: usize,
        beta: f64,
        level: Level,
    ) -> f64 {
        let g = geometry.relative(i, j).cast::<f32>();
        let still = Se3 {
            translation: g.translation,
            ..Se3::identity()
        };
        let lens = geometry.lens;
        let (focal, centre) = (
            [lens.fx as f32, lens.fy as f32],
            [lens.cx as f32, lens.cy as f32],
        );
        let disparity = geometry.disparity[i].as_slice();
        let mut sums = Sums::default();
        for (motion, share) in [(g, beta), (still, 1.0 - beta)] {
            let (length, valid) =
                dispatch!(level, _s => self.sum(&motion, focal, centre, disparity));
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
pub fn symmetric_distances(
    geometry: &Geometry<f32>,
    pairs: &[(usize, usize)],
    beta: f64,
) -> Vec<f64> {
    let (rays, level) = (Rays::new(geometry), Level::new());
    pairs
        .par_iter()
        .map(|&(i, j)| {
            0.5 * (rays.distance(geometry, i, j, beta, level)
                + rays.distance(geometry, j, i, beta, level))
        })
        .collect()
}
