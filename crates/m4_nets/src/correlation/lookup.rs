//! Lookups: on the processor the scores that a window touches; elsewhere all scores of some rows of
//! the source at a time, of which those in the windows are gathered.

use super::{Pyramid, Values, first_and_fraction, reach, side, taps};
use burn_core::tensor::{DType, Int, Tensor};
use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16};
use rayon::prelude::*;

const LANES: usize = 16;
/// Neighbours in a row whose products are summed side by side.
const RUN: usize = 4;

/// [`scores`](super::scores) of `features` `[h * w][c]` (divided by 4) on a row of `w` pixels after
/// the other, written to `out` `[h * w][taps]`; `centres` `[h * w][2]`.
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
fn row<S: Simd>(
    s: S,
    features: &[f32],
    c: usize,
    target: &Pyramid,
    centres: &[f32],
    radius: usize,
    out: &mut [f32],
) {
    let side = side(radius);
    let mut products = vec![0.0; (side + 1) * (side + 1)];
    let pixels = out.chunks_exact_mut(taps(target.levels().len(), radius));
    for ((out, feature), centre) in pixels
        .zip(features.chunks_exact(c))
        .zip(centres.chunks_exact(2))
    {
        let mut shrink = 1.0;
        for (map, out) in target
            .levels()
            .iter()
            .zip(out.chunks_exact_mut(side * side))
        {
            let [h, w, _] = map.size();
            let (x0, fx) = first_and_fraction(centre[0] * shrink, w, radius);
            let (y0, fy) = first_and_fraction(centre[1] * shrink, h, radius);
            shrink *= 0.5;
            products.fill(0.0);
            if let Values::Processor(values) = map.values() {
                let columns = overlap(x0, side + 1, w);
                let rows = if columns.is_empty() {
                    0..0
                } else {
                    overlap(y0, side + 1, h)
                };
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
    let weights = [
        (1.0 - fx) * (1.0 - fy),
        fx * (1.0 - fy),
        (1.0 - fx) * fy,
        fx * fy,
    ];
    for (dx, out) in out.chunks_exact_mut(side).enumerate() {
        for (dy, out) in out.iter_mut().enumerate() {
            let at = dy * (side + 1) + dx;
            *out = (products[at] * weights[0] + products[at + 1] * weights[1])
                + (products[at + side + 1] * weights[2] + products[at + side + 2] * weights[3]);
        }
    }
}

/// Scores that are made at a time, at most (unless one row of the source has more).
const AT_ONCE: usize = 1 << 24;

/// [`scores`](super::scores) of `features` `[h, w, c]`, divided by 4.
pub fn scores(
    features: Tensor<3>,
    target: &Pyramid,
    centres: Tensor<3>,
    radius: usize,
) -> Tensor<3> {
    let [h, w, c] = features.dims();
    let [target_h, target_w, _] = target.levels()[0].size();
    let rows = (AT_ONCE / (w * target_h * target_w).max(1)).clamp(1, h.max(1));
    let parts = features
        .split(rows, 0)
        .into_iter()
        .zip(centres.split(rows, 0));
    let parts = parts.map(|(features, centres)| {
        let n = features.dims()[0] * w;
        let features = features.reshape([n, c]);
        let centres = centres.reshape([n, 2]);
        let levels = (0..).zip(target.levels()).map(|(level, map)| {
            let Values::Device(values) = map.values() else {
                return features
                    .zeros_like()
                    .narrow(1, 0, 1)
                    .repeat_dim(1, side(radius).pow(2));
            };
            let [h, w, _] = map.size();
            let all = features
                .clone()
                .matmul(values.clone().reshape([h * w, c]).transpose());
            windows(
                all,
                [h, w],
                centres.clone().div_scalar((1_u32 << level) as f32),
                radius,
            )
        });
        Tensor::cat(levels.collect(), 1)
    });
    let all = Tensor::cat(parts.collect::<Vec<_>>(), 0);
    let taps = all.dims()[1];
    all.reshape([h, w, taps])
}

/// Of scores `all` `[n, h * w]` those around `centres` `[n, 2]`: `[n, (2 radius + 1)^2]`.
fn windows(all: Tensor<2>, [h, w]: [usize; 2], centres: Tensor<2>, radius: usize) -> Tensor<2> {
    let n = all.dims()[0];
    let wide = side(radius) + 1;
    let (x, inside_x, fx) = along(centres.clone().narrow(1, 0, 1), w, radius);
    let (y, inside_y, fy) = along(centres.narrow(1, 1, 1), h, radius);
    // x is the slow index
    let at = x.unsqueeze_dim::<3>(2) + y.mul_scalar(w as i64).unsqueeze_dim::<3>(1);
    let inside = inside_x.unsqueeze_dim::<3>(2) * inside_y.unsqueeze_dim::<3>(1);
    let dtype = all.dtype();
    let taps = all
        .gather(1, at.reshape([n, wide * wide]))
        .reshape([n, wide, wide]);
    // in 32 bits, as positions are
    let taps = taps.cast(DType::F32) * inside;
    let mix = |taps: Tensor<3>, dim: usize, fraction: Tensor<2>| {
        let fraction = fraction.unsqueeze_dim::<3>(2);
        let near = taps.clone().narrow(dim, 0, wide - 1);
        near.clone() + (taps.narrow(dim, 1, wide - 1) - near) * fraction
    };
    let taps = mix(mix(taps, 1, fx), 2, fy);
    taps.reshape([n, (wide - 1) * (wide - 1)]).cast(dtype)
}

/// Along one axis, for centres `[n, 1]`: the whole positions `[n, 2 radius + 2]` that a window
/// touches, moved inside; 1 where they were inside, else 0; the fraction `[n, 1]`.
fn along(
    centre: Tensor<2>,
    extent: usize,
    radius: usize,
) -> (Tensor<2, Int>, Tensor<2>, Tensor<2>) {
    let [low, high] = reach(extent, radius);
    let outside = centre.clone().is_nan();
    let centre = centre.mask_fill(outside, low).clamp(low, high);
    let whole = centre.clone().floor();
    let fraction = centre - whole.clone();
    let r = radius as i64;
    let offsets = Tensor::<1, Int>::arange(-r..r + 2, &whole.device()).unsqueeze::<2>();
    let at = whole.int() + offsets;
    let near = at.clone().clamp(0, extent as i64 - 1);
    let inside = at.equal(near.clone()).float().cast(DType::F32);
    (near, inside, fraction)
}
