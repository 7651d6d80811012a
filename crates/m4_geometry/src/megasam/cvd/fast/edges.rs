//! The multi-scale gradient term of one frame. The definition is `reference::gradient_loss`.

use super::exp;
use super::shape::Shape;
use super::surface::sum;
use crate::megasam::cvd::reference::INTERVALS;

/// Planes of one frame at one scale, used again and again.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    off: Vec<f32>,
    log_initial: Vec<f32>,
    pull: Vec<f32>,
    rows: [Vec<f32>; 3],
}

/// Row stride and size of what a scale looks at.
#[derive(Debug, Clone, Copy)]
struct Scale {
    stride: usize,
    width: usize,
    height: usize,
}

/// Adds to `pull` (plain) the gradient with respect to `off = log(initial) - log(disparity)`
/// (plain), times `weight`, of the means over `frames` frames; returns the weighted loss.
#[inline(always)]
pub(super) fn gradient_term(
    shape: Shape,
    frames: usize,
    weight: f64,
    off: &[f32],
    log_initial: &[f32],
    pull: &mut [f32],
    scratch: &mut Scratch,
) -> f64 {
    let mut loss = 0.0;
    for interval in INTERVALS {
        let (width, height) = (shape.width / interval, shape.height / interval);
        if width < 3 || height < 3 {
            continue;
        }
        let weight = weight / (frames * (width - 2) * (height - 2)) as f64;
        let Scratch {
            off: small_off,
            log_initial: small_initial,
            pull: small_pull,
            rows,
        } = &mut *scratch;
        for row in &mut *rows {
            row.resize(shape.width, 0.0);
        }
        if interval == 1 {
            let scale = Scale {
                stride: shape.stride,
                width,
                height,
            };
            loss += one_scale(scale, weight, off, log_initial, pull, rows);
            continue;
        }
        let scale = Scale {
            stride: width,
            width,
            height,
        };
        let at = |x: usize, y: usize| {
            (y * interval + interval / 2) * shape.stride + x * interval + interval / 2
        };
        for (small, plane) in [(&mut *small_off, off), (&mut *small_initial, log_initial)] {
            small.clear();
            for y in 0..height {
                small.extend((0..width).map(|x| plane[at(x, y)]));
            }
        }
        small_pull.clear();
        small_pull.resize(width * height, 0.0);
        loss += one_scale(scale, weight, small_off, small_initial, small_pull, rows);
        for y in 0..height {
            for x in 0..width {
                pull[at(x, y)] += small_pull[y * width + x];
            }
        }
    }
    loss
}

#[inline(always)]
fn one_scale(
    scale: Scale,
    weight: f64,
    off: &[f32],
    log_initial: &[f32],
    pull: &mut [f32],
    rows: &mut [Vec<f32>; 3],
) -> f64 {
    let Scale {
        stride,
        width,
        height,
    } = scale;
    let inner = width - 2;
    let weight32 = weight as f32;
    let [losses, across, down] = rows;
    let (losses, across, down) = (
        &mut losses[..inner],
        &mut across[..inner],
        &mut down[..inner],
    );
    let mut loss = 0.0;
    for y in 1..height - 1 {
        let cut = |y: usize, x: usize| y * stride + x..y * stride + x + inner;
        let [left, right, middle] = [0, 2, 1].map(|x| &off[cut(y, x)]);
        let [top, bottom] = [y - 1, y + 1].map(|y| &off[cut(y, 1)]);
        let [i_left, i_right, i_middle] = [0, 2, 1].map(|x| &log_initial[cut(y, x)]);
        let [i_top, i_bottom] = [y - 1, y + 1].map(|y| &log_initial[cut(y, 1)]);
        row(
            left, right, top, bottom, middle, i_left, i_right, i_top, i_bottom, i_middle, weight32,
            losses, across, down,
        );
        loss += sum(losses);
        let mut add = |y: usize, x: usize, sign: f32, row: &[f32]| {
            let out = &mut pull[y * stride + x..][..inner];
            for x in 0..inner {
                out[x] += sign * row[x];
            }
        };
        add(y, 0, 1.0, across);
        add(y, 2, -1.0, across);
        add(y - 1, 1, 1.0, down);
        add(y + 1, 1, -1.0, down);
    }
    loss
}

/// One row: the loss and what pulls at the ends of both differences. A function of its own so that
/// the compiler knows that none of the slices overlap, which it needs for vectors.
#[inline(always)]
fn row(
    left: &[f32],
    right: &[f32],
    top: &[f32],
    bottom: &[f32],
    middle: &[f32],
    i_left: &[f32],
    i_right: &[f32],
    i_top: &[f32],
    i_bottom: &[f32],
    i_middle: &[f32],
    weight: f32,
    losses: &mut [f32],
    across: &mut [f32],
    down: &mut [f32],
) {
    let n = losses.len();
    let (left, right, top, bottom, middle) = (
        &left[..n],
        &right[..n],
        &top[..n],
        &bottom[..n],
        &middle[..n],
    );
    let (i_left, i_right, i_top) = (&i_left[..n], &i_right[..n], &i_top[..n]);
    let (i_bottom, i_middle) = (&i_bottom[..n], &i_middle[..n]);
    let (across, down) = (&mut across[..n], &mut down[..n]);
    for x in 0..n {
        let (dx, dy) = (left[x] - right[x], top[x] - bottom[x]);
        let (ix, iy) = (i_left[x] - i_right[x], i_top[x] - i_bottom[x]);
        let unlike = ((ix.abs() + iy.abs()) - ((ix - dx).abs() + (iy - dy).abs())).abs();
        // where the disparity is above 1
        let near = if i_middle[x] > middle[x] { weight } else { 0.0 };
        let w = near * (1.0 - exp(-5.0 * unlike));
        losses[x] = w * (dx.abs() + dy.abs());
        across[x] = if dx == 0.0 { 0.0 } else { w.copysign(dx) };
        down[x] = if dy == 0.0 { 0.0 } else { w.copysign(dy) };
    }
}
