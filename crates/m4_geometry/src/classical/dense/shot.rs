//! One frame with everything that the geometry of its neighbours needs.

use super::pair::{Pair, parallax_px};
use super::sweep::{Range, census};
use super::working::WorkingFrame;
use crate::classical::reconstruction::{Motion, SparseReconstruction};
use m4_core::quantile;

/// Disparities tried between the farthest and the nearest surface.
const HYPOTHESES: usize = 64;
/// Parallax of a point at median depth between a frame and its partners on each side, pixels at the working size: one partner per
/// target and side.
const PARALLAX_PX: [f64; 2] = [6.0, 12.0];
/// How far away in time partners may be, frames. Specification: 8; slow cameras need more.
const PARTNER_FRAMES: usize = 24;
/// Least parallax of a partner, pixels at the working size.
const LEAST_PARALLAX_PX: f64 = 1.5;

/// A sparse point in a frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct SparsePoint {
    /// Pixel index at the working size.
    pub pixel: usize,
    pub disparity: f32,
}

/// One frame, ready for the plane sweep.
pub(super) struct Shot {
    pub frame: WorkingFrame,
    pub census: Vec<u32>,
    pub points: Vec<SparsePoint>,
    /// Frames to compare with, and the way there.
    pub partners: Vec<(usize, Pair)>,
    pub range: Range,
}

/// Sparse points per frame, at a working size `scale` times the full size.
pub(super) fn sparse_points(sparse: &SparseReconstruction, width: usize, height: usize) -> Vec<Vec<SparsePoint>> {
    let mut out = vec![Vec::new(); sparse.cameras.len()];
    for track in &sparse.tracks {
        let (Some(point), false) = (track.point, track.motion == Motion::Dynamic) else {
            continue;
        };
        for (k, seen) in track.observations.iter().enumerate() {
            let Some(camera) = sparse.cameras.get(track.first_frame + k) else {
                break;
            };
            let (_, z) = camera.project(&point);
            let k_full = &camera.intrinsics;
            let x = (f64::from(seen[0]) + 0.5) * width as f64 / k_full.width as f64;
            let y = (f64::from(seen[1]) + 0.5) * height as f64 / k_full.height as f64;
            if z > 0.0 && z.is_finite() && x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64 {
                out[track.first_frame + k]
                    .push(SparsePoint { pixel: y as usize * width + x as usize, disparity: (1.0 / z) as f32 });
            }
        }
    }
    out
}

/// Disparities worth trying: those of the points in the frame and around it in time, with room for
/// nearer and farther surfaces that no point lies on.
fn range(points: &[Vec<SparsePoint>], i: usize) -> (Range, f32) {
    const WINDOW: usize = 8;
    const ENOUGH: usize = 50;
    let collect =
        |from: usize, to: usize| -> Vec<f32> { points[from..to].iter().flatten().map(|p| p.disparity).collect() };
    let mut values = collect(i.saturating_sub(WINDOW), (i + WINDOW + 1).min(points.len()));
    if values.len() < ENOUGH {
        values = collect(0, points.len());
    }
    let median = quantile(&mut values, 0.5).unwrap_or(1.0);
    let far = quantile(&mut values, 0.01).unwrap_or(0.5);
    let near = quantile(&mut values, 0.99).unwrap_or(2.0);
    let (least, most) = (0.6 * far, 1.4 * near.max(1.2 * median));
    let range = Range { least, step: (most - least) / (HYPOTHESES - 1) as f32, count: HYPOTHESES };
    (range, median)
}

/// On each side in time, the frame whose parallax comes nearest to each target; where the clip ends,
/// the other side serves twice as many.
fn partners(frames: &[WorkingFrame], i: usize, median: f32) -> Vec<(usize, Pair)> {
    let parallax = |j: usize| parallax_px(&frames[i].camera, &frames[j].camera, f64::from(median));
    let up_to = |reach: usize, later: bool| -> Vec<(usize, f64)> {
        (1..=reach)
            .map_while(|k| if later { (i + k < frames.len()).then_some(i + k) } else { i.checked_sub(k) })
            .map(|j| (j, parallax(j)))
            .filter(|&(_, p)| p >= LEAST_PARALLAX_PX)
            .collect()
    };
    // Where the camera pauses, time goes on until it moves.
    let side = |later: bool| {
        let near = up_to(PARTNER_FRAMES, later);
        if near.is_empty() { up_to(frames.len(), later) } else { near }
    };
    let (before, after) = (side(false), side(true));
    let mut chosen: Vec<usize> = Vec::new();
    for target in PARALLAX_PX {
        for side in [&before, &after] {
            // On a side that is too short for this target, another parallax on the other side serves.
            let reaches = side.iter().any(|&(_, p)| p >= 0.7 * target);
            let (side, target) = match (reaches, side == &before) {
                (true, _) => (side, target),
                (false, true) => (&after, 1.4 * target),
                (false, false) => (&before, 1.4 * target),
            };
            let free = side.iter().filter(|(j, _)| !chosen.contains(j));
            let miss = |p: f64| (p / target).ln().abs();
            if let Some(&(j, _)) = free.min_by(|a, b| miss(a.1).total_cmp(&miss(b.1))) {
                chosen.push(j);
            }
        }
    }
    chosen.sort_unstable();
    chosen.into_iter().map(|j| (j, Pair::new(&frames[i].camera, &frames[j].camera))).collect()
}

impl Shot {
    pub fn new(frames: &[WorkingFrame], i: usize, points: &[Vec<SparsePoint>], parallax: bool) -> Self {
        let frame = frames[i].clone();
        let (range, median) = range(points, i);
        Self {
            census: census(frame.width, frame.height, &frame.grey),
            points: points[i].clone(),
            partners: if parallax { partners(frames, i, median) } else { Vec::new() },
            range,
            frame,
        }
    }
}
