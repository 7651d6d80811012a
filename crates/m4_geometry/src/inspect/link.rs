//! How two images hang together: points of one that are found in the other.

use crate::classical::sparse::klt::follow;
use crate::classical::sparse::luma::{halvings, sample_square};
use crate::classical::sparse::tracking::fill_empty_cells;
use m4_core::Plane;

/// Longest side of the images that are compared, pixels.
pub(super) const SIDE_PX: usize = 160;
/// Least normalised cross-correlation of a patch with itself in the other image.
const MIN_CORRELATION: f32 = 0.7;
/// A point followed there and back returns this close, pixels.
const MAX_ROUND_TRIP_PX: f32 = 1.0;
/// Values outside are cut off by the sensor, grey levels: no measure of exposure.
const EXPOSED: std::ops::RangeInclusive<f32> = 16.0..=235.0;
/// Fewest points of a measure.
const MIN_POINTS: usize = 5;

/// What two images have in common.
#[derive(Debug, Clone, Default)]
pub(super) struct Link {
    /// Share of the points of the first that are found in the second.
    pub share: f32,
    /// Mean absolute difference pixel by pixel, grey levels.
    pub difference: f32,
    /// Logarithm of the brightness of the second over that of the first, at the same points.
    pub log_gain: f32,
    /// Median motion of the points of each quadrant, image widths.
    pub motion: [[f32; 2]; 4],
}

impl Link {
    /// Compares two images of one size.
    pub fn new(a: &Plane<f32>, b: &Plane<f32>) -> Self {
        let (from, to) = (halvings(a.clone()), halvings(b.clone()));
        let corners = fill_empty_cells(a, &[]);
        let mut gains = Vec::new();
        let mut moves: [[Vec<f32>; 2]; 4] = Default::default();
        let (w, h) = (a.width() as f32, a.height() as f32);
        let mut n_found = 0;
        for &p in &corners {
            let Some(q) = again(&from, &to, p) else {
                continue;
            };
            n_found += 1;
            let quadrant = usize::from(p[0] > 0.5 * w) + 2 * usize::from(p[1] > 0.5 * h);
            for k in 0..2 {
                moves[quadrant][k].push((q[k] - p[k]) / w);
            }
            let (before, after) = (patch_mean(a, p), patch_mean(b, q));
            if EXPOSED.contains(&before) && EXPOSED.contains(&after) {
                gains.push((after / before).ln());
            }
        }
        let median = |values: &[f32]| {
            if values.len() < MIN_POINTS {
                0.0
            } else {
                super::quantile(values, 0.5)
            }
        };
        Self {
            share: n_found as f32 / corners.len().max(MIN_POINTS) as f32,
            difference: difference(a, b),
            log_gain: median(&gains),
            motion: moves.map(|axes| axes.map(|values| median(&values))),
        }
    }
}

/// Where the patch around `p` is in the other image, if it is found there and back.
fn again(from: &[Plane<f32>], to: &[Plane<f32>], p: [f32; 2]) -> Option<[f32; 2]> {
    let (q, correlation) = follow(from, to, p)?;
    if correlation < MIN_CORRELATION {
        return None;
    }
    let (back, _) = follow(to, from, q)?;
    ((back[0] - p[0]).hypot(back[1] - p[1]) <= MAX_ROUND_TRIP_PX).then_some(q)
}

/// Mean of the patch around `p`, between pixels as at them.
fn patch_mean(plane: &Plane<f32>, p: [f32; 2]) -> f32 {
    const REACH: usize = 3;
    const SIDE: usize = 2 * REACH + 1;
    let mut values = [0.0; SIDE * SIDE];
    let [x, y] = p.map(|v| v - REACH as f32);
    sample_square(plane, x, y, SIDE, &mut values);
    values.iter().sum::<f32>() / values.len() as f32
}

fn difference(a: &Plane<f32>, b: &Plane<f32>) -> f32 {
    let sum: f64 = a
        .data()
        .iter()
        .zip(b.data())
        .map(|(a, b)| f64::from((a - b).abs()))
        .sum();
    (sum / a.data().len().max(1) as f64) as f32
}

/// Mean length of the gradient, grey levels per pixel: the detail of an image.
pub(super) fn detail(plane: &Plane<f32>) -> f32 {
    let (w, h) = plane.size();
    let (mut sum, mut n) = (0.0_f64, 0_usize);
    for y in 0..h.saturating_sub(1) {
        let (row, below) = (plane.row(y), plane.row(y + 1));
        for x in 0..w.saturating_sub(1) {
            sum += f64::from((row[x + 1] - row[x]).hypot(below[x] - row[x]));
            n += 1;
        }
    }
    (sum / n.max(1) as f64) as f32
}

/// Side of the images whose rough likeness is measured, pixels.
const COARSE_PX: usize = 40;
/// Shifts that are tried, share of a side.
const MOST_SHIFT: f64 = 0.35;

/// An image reduced to what is larger than a few per cent of its width and smaller than a fifth of
/// it.
pub(super) fn coarse(plane: &Plane<f32>) -> Plane<f32> {
    const REACH: usize = 4;
    let step = plane.width().max(plane.height()).div_ceil(COARSE_PX).max(1);
    let (w, h) = (plane.width() / step, plane.height() / step);
    let low = Plane::from_fn(w, h, |x, y| {
        let mut sum = 0.0;
        for row in y * step..(y + 1) * step {
            sum += plane.row(row)[x * step..(x + 1) * step].iter().sum::<f32>();
        }
        sum / (step * step) as f32
    });
    Plane::from_fn(w, h, |x, y| {
        let (mut sum, mut n) = (0.0, 0);
        for row in y.saturating_sub(REACH)..(y + REACH + 1).min(h) {
            for v in &low.row(row)[x.saturating_sub(REACH)..(x + REACH + 1).min(w)] {
                sum += v;
                n += 1;
            }
        }
        low[(x, y)] - sum / n as f32
    })
}

/// Greatest normalised cross-correlation of two [`coarse`] images over shifts.
pub(super) fn likeness(a: &Plane<f32>, b: &Plane<f32>) -> f32 {
    let (w, h) = (a.width() as isize, a.height() as isize);
    let most = |n: isize| (n as f64 * MOST_SHIFT) as isize;
    let mut best = -1.0_f32;
    for dy in -most(h)..=most(h) {
        for dx in -most(w)..=most(w) {
            let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
            for y in 0.max(-dy)..h.min(h - dy) {
                let (x0, x1) = (0.max(-dx), w.min(w - dx));
                let row = &a.row(y as usize)[x0 as usize..x1 as usize];
                let other = &b.row((y + dy) as usize)[(x0 + dx) as usize..(x1 + dx) as usize];
                for (p, q) in row.iter().zip(other) {
                    (ab, aa, bb) = (ab + p * q, aa + p * p, bb + q * q);
                }
            }
            let norm = (aa * bb).sqrt();
            if norm > 0.0 {
                best = best.max(ab / norm);
            }
        }
    }
    best
}
