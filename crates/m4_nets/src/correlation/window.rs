//! Lookups on the processor: the scores that a window touches, when it touches them.

use super::pyramid::{Pyramid, Values};
use super::{first_and_fraction, side, taps};
use fearless_simd::{Level, Simd, dispatch, f32x16, prelude::*};
use rayon::prelude::*;

const LANES: usize = 16;
/// Neighbours in a row whose products are summed side by side.
const RUN: usize = 4;

/// [`scores`](super::scores) of `features` `[h * w][c]` (divided by 4) on a row of `w` pixels after the other, written to
/// `out` `[h * w][taps]`; `centres` `[h * w][2]`.
pub fn window_scores(
    features: &[f32],
    c: usize,
    w: usize,
    target: &Pyramid,
    centres: &[f32],
    radius: usize,
    out: &mut [f32],
) {
    let level = Level::new();
    let width = taps(target.levels().len(), radius);
    if w == 0 || c == 0 {
        return;
    }
    let rows = out.par_chunks_mut(w * width);
    rows.zip(features.par_chunks(w * c)).zip(centres.par_chunks(w * 2)).for_each(
        |((out, features), centres)| dispatch!(level, s => row(s, features, c, target, centres, radius, out)),
    );
}

#[inline(always)]
fn row<S: Simd>(s: S, features: &[f32], c: usize, target: &Pyramid, centres: &[f32], radius: usize, out: &mut [f32]) {
    let side = side(radius);
    let mut products = vec![0.0; (side + 1) * (side + 1)];
    let pixels = out.chunks_exact_mut(taps(target.levels().len(), radius));
    for ((out, feature), centre) in pixels.zip(features.chunks_exact(c)).zip(centres.chunks_exact(2)) {
        let mut shrink = 1.0;
        for (map, out) in target.levels().iter().zip(out.chunks_exact_mut(side * side)) {
            let [h, w, _] = map.size();
            let (x0, fx) = first_and_fraction(centre[0] * shrink, w, radius);
            let (y0, fy) = first_and_fraction(centre[1] * shrink, h, radius);
            shrink *= 0.5;
            products.fill(0.0);
            if let Values::Processor(values) = map.values() {
                let columns = overlap(x0, side + 1, w);
                let rows = if columns.is_empty() { 0..0 } else { overlap(y0, side + 1, h) };
                for iy in rows {
                    let y = (y0 + iy as i32) as usize;
                    let x = (x0 + columns.start as i32) as usize;
                    let run = &mut products[iy * (side + 1)..][columns.clone()];
                    let values = &values[(y * w + x) * c..][..run.len() * c];
                    dots(s, feature, values, run);
                }
            }
            blend(&products, side, fx, fy, out);
        }
    }
}

/// Which of the `n` whole numbers from `first` on are in `0..extent`.
fn overlap(first: i32, n: usize, extent: usize) -> std::ops::Range<usize> {
    let start = first.min(0).unsigned_abs() as usize;
    let end = (extent as i64 - i64::from(first)).clamp(0, n as i64) as usize;
    start.min(end)..end
}

/// `a . b` of each `b` in `values`.
#[inline(always)]
fn dots<S: Simd>(s: S, a: &[f32], values: &[f32], out: &mut [f32]) {
    let c = a.len();
    let (many, few) = out.as_chunks_mut::<RUN>();
    let (ahead, rest) = values.split_at(many.len() * RUN * c);
    for (out, values) in many.iter_mut().zip(ahead.chunks_exact(RUN * c)) {
        *out = dots_of::<S, RUN>(s, a, values);
    }
    for (out, values) in few.iter_mut().zip(rest.chunks_exact(c)) {
        [*out] = dots_of::<S, 1>(s, a, values);
    }
}

#[inline(always)]
fn dots_of<S: Simd, const N: usize>(s: S, a: &[f32], values: &[f32]) -> [f32; N] {
    let c = a.len();
    let (vectors, tail) = a.as_chunks::<LANES>();
    let mut sums = [f32x16::splat(s, 0.0); N];
    let mut b = [values; N];
    for n in 0..N {
        b[n] = &values[n * c..][..c];
    }
    for (k, a) in vectors.iter().enumerate() {
        let a = f32x16::simd_from(s, *a);
        for n in 0..N {
            let b = b[n].as_chunks::<LANES>().0;
            sums[n] = a.mul_add(f32x16::simd_from(s, b[k]), sums[n]);
        }
    }
    let mut out = [0.0; N];
    for n in 0..N {
        let b = &b[n][c - tail.len()..];
        let rest: f32 = tail.iter().zip(b).map(|(a, b)| a * b).sum();
        out[n] = sums[n].reduce_sum() + rest;
    }
    out
}

/// Scores `[dx][dy]` between the whole positions of `products` `[y][x]`.
fn blend(products: &[f32], side: usize, fx: f32, fy: f32, out: &mut [f32]) {
    let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
    for (dx, out) in out.chunks_exact_mut(side).enumerate() {
        for (dy, out) in out.iter_mut().enumerate() {
            let at = dy * (side + 1) + dx;
            *out = (products[at] * weights[0] + products[at + 1] * weights[1])
                + (products[at + side + 1] * weights[2] + products[at + side + 2] * weights[3]);
        }
    }
}
