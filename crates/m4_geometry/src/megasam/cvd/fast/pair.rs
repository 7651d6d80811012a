//! The ratio and the flow term of all pairs of one source: loss, gradients, and what is added to
//! the targets'.
//!
//! Row by row of the source, so that its own sums stay in the first-level cache; for each pair the
//! row passes through four short loops: reproject, read four taps, compare, add to four taps. The
//! definition is `reference::pair_losses`; sums here lack the division by the number of pixels that
//! count, which is known when all tasks are through.

use super::ln;
use super::shape::{Motion, Shape};
use crate::megasam::cvd::Weights;
use crate::megasam::cvd::pairs::{CompactFlow, LANES, MASKED};
use crate::megasam::cvd::reference::LOG_WEIGHT;
use fearless_simd::{Simd, f32x16, i32x16, prelude::*};

/// One pair as the kernel sees it.
pub(super) struct PairBuffers<'a> {
    pub flow: &'a CompactFlow,
    pub motion: Motion,
    /// Disparity of the target, bordered.
    pub seen: &'a [f32],
    /// What its gradient grows by, bordered.
    pub scatter: &'a mut [f32],
}

/// The source.
pub(super) struct Source<'a> {
    /// Disparity, bordered.
    pub seen: &'a [f32],
    /// Inside its limits, plain.
    pub uncertainty: &'a [f32],
    /// Gradients, plain; overwritten.
    pub by_disparity: &'a mut [f32],
    pub by_uncertainty: &'a mut [f32],
}

/// Sums over the pixels that count.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Sums {
    /// Weighted ratio and flow term.
    pub loss: f64,
    /// Pixels.
    pub count: f64,
}

/// Rows of one source, used again and again.
#[derive(Debug, Default)]
pub(super) struct Rows {
    depth: Vec<f32>,
    by_depth: Vec<f32>,
    errors: Vec<f32>,
    count: Vec<f32>,
    // of one pair
    z: Vec<f32>,
    counts: Vec<f32>,
    index: Vec<i32>,
    right: Vec<f32>,
    lower: Vec<f32>,
    sampled: Vec<f32>,
}

impl Rows {
    fn resize(&mut self, stride: usize) {
        let floats = [
            &mut self.depth,
            &mut self.by_depth,
            &mut self.errors,
            &mut self.count,
            &mut self.z,
            &mut self.counts,
            &mut self.right,
            &mut self.lower,
            &mut self.sampled,
        ];
        for row in floats {
            row.resize(stride, 0.0);
        }
        self.index.resize(stride, 0);
    }
}

#[inline(always)]
pub(super) fn source<S: Simd>(
    s: S,
    shape: Shape,
    weights: &Weights,
    source: Source<'_>,
    pairs: &mut [PairBuffers<'_>],
    rows: &mut Rows,
) -> Sums {
    rows.resize(shape.stride);
    let (w_ratio, w_flow) = (weights.ratio as f32, 0.5 * weights.flow as f32);
    let log_weight = ((weights.ratio + weights.flow) * LOG_WEIGHT) as f32;
    let mut sums = Sums::default();
    for y in 0..shape.height {
        let disparity = &source.seen[shape.tap_row(y)..][..shape.stride];
        let plain = y * shape.stride..(y + 1) * shape.stride;
        let uncertainty = &source.uncertainty[plain.clone()];
        for (depth, &disparity) in rows.depth.iter_mut().zip(disparity) {
            // the border holds zeros; its pixels never count
            *depth = 1.0 / if disparity > 0.0 { disparity } else { 1.0 };
        }
        for row in [&mut rows.by_depth, &mut rows.errors, &mut rows.count] {
            row.fill(0.0);
        }
        for pair in &mut *pairs {
            let codes = &pair.flow.codes[2 * plain.start..2 * plain.end];
            reproject(
                s,
                shape,
                y,
                pair.flow.unit_px,
                codes,
                &pair.motion,
                w_flow,
                rows,
            );
            read(shape.tap_stride, pair.seen, rows);
            compare(s, &pair.motion, y, w_ratio, uncertainty, rows);
            add(shape.tap_stride, pair.scatter, rows);
        }
        let by_disparity = &mut source.by_disparity[plain.clone()];
        let by_uncertainty = &mut source.by_uncertainty[plain];
        let here = finish(rows, uncertainty, log_weight, by_disparity, by_uncertainty);
        sums.loss += here.loss;
        sums.count += here.count;
    }
    sums
}

/// The row's gradients and sums from what all pairs have added up.
#[inline(always)]
fn finish(
    rows: &Rows,
    uncertainty: &[f32],
    log_weight: f32,
    by_disparity: &mut [f32],
    by_uncertainty: &mut [f32],
) -> Sums {
    let n = uncertainty.len();
    let (depth, by_depth) = (&rows.depth[..n], &rows.by_depth[..n]);
    let (count, errors) = (&rows.count[..n], &rows.errors[..n]);
    let (by_disparity, by_uncertainty) = (&mut by_disparity[..n], &mut by_uncertainty[..n]);
    let (mut losses, mut counts) = ([0.0f32; LANES], [0.0f32; LANES]);
    for x in 0..n {
        by_disparity[x] = -depth[x] * depth[x] * uncertainty[x] * by_depth[x];
        by_uncertainty[x] = errors[x] - log_weight * count[x] / uncertainty[x];
    }
    for at in (0..n).step_by(LANES) {
        let (u, error, count) = (
            &uncertainty[at..at + LANES],
            &errors[at..at + LANES],
            &count[at..at + LANES],
        );
        for k in 0..LANES {
            losses[k] += u[k] * error[k] - log_weight * count[k] * ln(u[k]);
            counts[k] += count[k];
        }
    }
    Sums {
        loss: losses.iter().map(|&l| f64::from(l)).sum(),
        count: counts.iter().map(|&c| f64::from(c)).sum(),
    }
}

/// Where the row lands: the flow term, and indices and weights of the taps.
#[inline(always)]
fn reproject<S: Simd>(
    s: S,
    shape: Shape,
    y: usize,
    unit_px: f32,
    codes: &[i16],
    motion: &Motion,
    w_flow: f32,
    rows: &mut Rows,
) {
    let all = |v: f32| f32x16::splat(s, v);
    let (zero, one) = (all(0.0), all(1.0));
    let y = y as f32;
    let base = motion.turn.map(|r| all(r[1] * y + r[2]));
    let along = motion.turn.map(|r| all(r[0]));
    let shift = motion.shift.map(all);
    let lanes: f32x16<S> =
        f32x16::from_slice(s, &std::array::from_fn::<f32, LANES, _>(|k| k as f32));
    let (width, height) = (all(shape.width as f32), all(shape.height as f32));
    let (unit, half) = (all(unit_px), all(w_flow));
    let (tap_stride, origin) = (
        i32x16::splat(s, shape.tap_stride as i32),
        i32x16::splat(s, shape.origin() as i32),
    );
    let (xs, ys) = codes.split_at(shape.stride);
    for at in (0..shape.stride).step_by(LANES) {
        let (mut cx, mut cy, mut counts) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
        let (xs, ys) = (&xs[at..at + LANES], &ys[at..at + LANES]);
        for k in 0..LANES {
            cx[k] = f32::from(xs[k]);
            cy[k] = f32::from(ys[k]);
            counts[k] = if xs[k] == MASKED { 0.0 } else { 1.0 };
        }
        let x = lanes + all(at as f32);
        let depth = f32x16::from_slice(s, &rows.depth[at..at + LANES]);
        let turned = [
            along[0].mul_add(x, base[0]),
            along[1].mul_add(x, base[1]),
            along[2].mul_add(x, base[2]),
        ];
        let z = turned[2].mul_add(depth, shift[2]);
        let counts = z
            .simd_gt(all(0.1))
            .select(f32x16::from_slice(s, &counts), zero);
        // where it does not count z may be anything, and must not make infinities
        let z = counts.simd_gt(zero).select(z, one);
        let far = z.simd_gt(all(1e3));
        let inverse = one / far.select(all(1e3), z);
        let (u, v) = (
            turned[0].mul_add(depth, shift[0]) * inverse,
            turned[1].mul_add(depth, shift[1]) * inverse,
        );
        let (qx, qy) = (
            f32x16::from_slice(s, &cx).mul_add(unit, x),
            f32x16::from_slice(s, &cy).mul_add(unit, all(y)),
        );
        let (ex, ey) = (u - qx, v - qy);
        let (sx, sy) = (sign(s, ex), sign(s, ey));
        let fall = far.select(zero, turned[2]);
        let slope = (sx * (turned[0] - u * fall) + sy * (turned[1] - v * fall)) * inverse;
        let share = counts * half;
        let add = |row: &mut [f32], value: f32x16<S>| {
            let row = &mut row[at..at + LANES];
            (f32x16::from_slice(s, row) + value).store_slice(row);
        };
        add(&mut rows.by_depth, share * slope);
        add(&mut rows.errors, share * (ex.abs() + ey.abs()));
        add(&mut rows.count, counts);
        let qx = qx.max(all(-1.0)).min(width);
        let qy = qy.max(all(-1.0)).min(height);
        let (x0, y0) = (qx.floor(), qy.floor());
        (qx - x0).store_slice(&mut rows.right[at..at + LANES]);
        (qy - y0).store_slice(&mut rows.lower[at..at + LANES]);
        z.store_slice(&mut rows.z[at..at + LANES]);
        counts.store_slice(&mut rows.counts[at..at + LANES]);
        let index = y0.to_int::<i32x16<S>>() * tap_stride + x0.to_int::<i32x16<S>>() + origin;
        index.store_slice(&mut rows.index[at..at + LANES]);
    }
}

/// -1, 0 or 1.
#[inline(always)]
fn sign<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    let (zero, one) = (f32x16::splat(s, 0.0), f32x16::splat(s, 1.0));
    x.simd_eq(zero).select(zero, one.copysign(x))
}

/// The four taps of each pixel, mixed.
#[inline(always)]
fn read(tap_stride: usize, disparity: &[f32], rows: &mut Rows) {
    let n = rows.index.len();
    let (right, lower, sampled) = (&rows.right[..n], &rows.lower[..n], &mut rows.sampled[..n]);
    for x in 0..n {
        let at = rows.index[x] as usize;
        let taps = &disparity[at..at + tap_stride + 2];
        let (r, l) = (right[x], lower[x]);
        let top = taps[0] + r * (taps[1] - taps[0]);
        let bottom = taps[tap_stride] + r * (taps[tap_stride + 1] - taps[tap_stride]);
        sampled[x] = top + l * (bottom - top);
    }
}

/// The ratio term; `sampled` becomes the gradient with respect to it.
#[inline(always)]
fn compare<S: Simd>(
    s: S,
    motion: &Motion,
    y: usize,
    w_ratio: f32,
    uncertainty: &[f32],
    rows: &mut Rows,
) {
    let all = |v: f32| f32x16::splat(s, v);
    let (zero, one) = (all(0.0), all(1.0));
    let [a, b, c] = motion.turn[2];
    let (along, base) = (all(a), all(b * y as f32 + c));
    let lanes: f32x16<S> =
        f32x16::from_slice(s, &std::array::from_fn::<f32, LANES, _>(|k| k as f32));
    let (least, most, weight) = (all(1e-3), all(1e2), all(w_ratio));
    for at in (0..rows.index.len()).step_by(LANES) {
        let load = |row: &[f32]| f32x16::from_slice(s, &row[at..at + LANES]);
        let (raw, z, counts) = (load(&rows.sampled), load(&rows.z), load(&rows.counts));
        let far = z.simd_gt(all(1e3));
        let z = far.select(all(1e3), z);
        let sampled = raw.max(least).min(most);
        let up = sampled * z;
        let down = one / up;
        let above = up.simd_gt(one);
        let error = above.select(up, down) - one;
        // of the greater ratio with respect to `up`; none where both are 1
        let slope = above.select(one, zero - down * down);
        let slope = up.simd_eq(one).select(zero, slope);
        let share = weight * counts;
        let turned = along.mul_add(lanes + all(at as f32), base);
        let by_z = far.select(zero, slope * sampled);
        let add = |row: &mut [f32], value: f32x16<S>| {
            let row = &mut row[at..at + LANES];
            (f32x16::from_slice(s, row) + value).store_slice(row);
        };
        add(&mut rows.by_depth, share * by_z * turned);
        add(&mut rows.errors, share * error);
        let gradient = raw.simd_eq(sampled).select(share * slope * z, zero);
        (gradient * load(uncertainty)).store_slice(&mut rows.sampled[at..at + LANES]);
    }
}

/// Adds to the four taps of each pixel.
///
/// Neighbours mostly land side by side, where the right taps of one are the left taps of the next:
/// those are carried in registers. Storing a pair of taps and loading a pair that overlaps it would
/// stall every pixel.
#[inline(always)]
fn add(tap_stride: usize, scatter: &mut [f32], rows: &Rows) {
    let n = rows.index.len();
    let (right, lower, gradient) = (&rows.right[..n], &rows.lower[..n], &rows.sampled[..n]);
    // what is due at `next` and in the row below
    let (mut next, mut due_top, mut due_bottom) = (rows.index[0] as usize, 0.0, 0.0);
    for x in 0..n {
        let at = rows.index[x] as usize;
        let (r, l, g) = (right[x], lower[x], gradient[x]);
        let bottom = g * l;
        let top = g - bottom;
        let (top_right, bottom_right) = (top * r, bottom * r);
        if at != next {
            scatter[next] += due_top;
            scatter[next + tap_stride] += due_bottom;
            (due_top, due_bottom) = (0.0, 0.0);
        }
        scatter[at] += (top - top_right) + due_top;
        scatter[at + tap_stride] += (bottom - bottom_right) + due_bottom;
        (next, due_top, due_bottom) = (at + 1, top_right, bottom_right);
    }
    scatter[next] += due_top;
    scatter[next + tap_stride] += due_bottom;
}
