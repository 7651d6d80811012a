//! Lookups on any device: all scores of some rows of the source at a time, of which those in the windows are gathered.

use super::pyramid::{Pyramid, Values};
use super::{reach, side};
use burn_core::tensor::{DType, Int, Tensor};

/// Scores that are made at a time, at most (unless one row of the source has more).
const AT_ONCE: usize = 1 << 24;

/// [`scores`](super::scores) of `features` `[h, w, c]`, divided by 4.
pub fn scores(features: Tensor<3>, target: &Pyramid, centres: Tensor<3>, radius: usize) -> Tensor<3> {
    let [h, w, c] = features.dims();
    let [target_h, target_w, _] = target.levels()[0].size();
    let rows = (AT_ONCE / (w * target_h * target_w).max(1)).clamp(1, h.max(1));
    let parts = features.split(rows, 0).into_iter().zip(centres.split(rows, 0));
    let parts = parts.map(|(features, centres)| {
        let n = features.dims()[0] * w;
        let features = features.reshape([n, c]);
        let centres = centres.reshape([n, 2]);
        let levels = (0..).zip(target.levels()).map(|(level, map)| {
            let Values::Device(values) = map.values() else {
                return features.zeros_like().narrow(1, 0, 1).repeat_dim(1, side(radius).pow(2));
            };
            let [h, w, _] = map.size();
            let all = features.clone().matmul(values.clone().reshape([h * w, c]).transpose());
            windows(all, [h, w], centres.clone().div_scalar((1_u32 << level) as f32), radius)
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
    let taps = all.gather(1, at.reshape([n, wide * wide])).reshape([n, wide, wide]);
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

/// Along one axis, for centres `[n, 1]`: the whole positions `[n, 2 radius + 2]` that a window touches, moved inside; 1 where
/// they were inside, else 0; the fraction `[n, 1]`.
fn along(centre: Tensor<2>, extent: usize, radius: usize) -> (Tensor<2, Int>, Tensor<2>, Tensor<2>) {
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
