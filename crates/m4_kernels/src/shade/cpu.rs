//! The SIMD version: sixteen colours at a time.

use super::{C0, C1, C2, C3};
use crate::{
    simd::{all, dot, each, load, sin_cos_turns, store},
    slice::cpu::Columns,
};
use fearless_simd::{Simd, f32x16, prelude::*};
use m4_core::Column;

/// From where and when sixteen splats are seen.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sight<S: Simd> {
    /// Unit vector from the camera's centre to the splat.
    pub(crate) direction: [f32x16<S>; 3],
    /// One over the distance.
    pub(crate) inverse_distance: f32x16<S>,
    /// `(t - time_mean) / period`.
    pub(crate) turns: f32x16<S>,
}

/// The gradient that colours pass on to geometry.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SightGradient<S: Simd> {
    /// With respect to the vector from the camera's centre to the splat.
    pub(crate) offset: [f32x16<S>; 3],
    /// With respect to `time_mean`, through the cosines alone.
    pub(crate) time_mean: f32x16<S>,
}

/// The harmonics of a direction; entries past `terms` are not set.
#[inline(always)]
fn harmonics<S: Simd>(s: S, d: &[f32x16<S>; 3], terms: usize, out: &mut [f32x16<S>; 16]) {
    let k = |v: f64| all(s, v as f32);
    let [x, y, z] = *d;
    out[0] = k(C0);
    if terms > 1 {
        out[1] = k(-C1) * y;
        out[2] = k(C1) * z;
        out[3] = k(-C1) * x;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if terms > 4 {
        out[4] = k(C2[0]) * x * y;
        out[5] = k(C2[1]) * y * z;
        out[6] = k(C2[2]) * (zz + zz - xx - yy);
        out[7] = k(C2[3]) * x * z;
        out[8] = k(C2[4]) * (xx - yy);
    }
    if terms > 9 {
        let three = k(3.0);
        let four_zz = k(4.0) * zz;
        out[9] = k(C3[0]) * y * (three * xx - yy);
        out[10] = k(C3[1]) * x * y * z;
        out[11] = k(C3[2]) * y * (four_zz - xx - yy);
        out[12] = k(C3[3]) * z * (zz + zz - three * (xx + yy));
        out[13] = k(C3[4]) * x * (four_zz - xx - yy);
        out[14] = k(C3[5]) * z * (xx - yy);
        out[15] = k(C3[6]) * x * (xx - three * yy);
    }
}

/// `sum_l pull[l] grad Y_l(d)`, harmonics as polynomials.
#[inline(always)]
fn harmonics_backward<S: Simd>(
    s: S,
    d: &[f32x16<S>; 3],
    terms: usize,
    pull: &[f32x16<S>; 16],
) -> [f32x16<S>; 3] {
    let k = |v: f64| all(s, v as f32);
    let [x, y, z] = *d;
    let mut g = [k(0.0); 3];
    if terms > 1 {
        g = [k(-C1) * pull[3], k(-C1) * pull[1], k(C1) * pull[2]];
    }
    let two = k(2.0);
    if terms > 4 {
        let a: [f32x16<S>; 5] = each!(5, i => k(C2[i]) * pull[4 + i]);
        g[0] += y * a[0] - two * x * a[2] + z * a[3] + two * x * a[4];
        g[1] += x * a[0] + z * a[1] - two * y * a[2] - two * y * a[4];
        g[2] += y * a[1] + k(4.0) * z * a[2] + x * a[3];
    }
    if terms > 9 {
        let a: [f32x16<S>; 7] = each!(7, i => k(C3[i]) * pull[9 + i]);
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (xy, yz, xz) = (x * y, y * z, x * z);
        let (three, four, six, eight) = (k(3.0), k(4.0), k(6.0), k(8.0));
        let ring = six * zz - three * (xx + yy);
        g[0] += six * xy * a[0] + yz * a[1] - two * xy * a[2] - six * xz * a[3]
            + (four * zz - three * xx - yy) * a[4]
            + two * xz * a[5]
            + three * (xx - yy) * a[6];
        g[1] += three * (xx - yy) * a[0] + xz * a[1] + (four * zz - xx - three * yy) * a[2]
            - six * yz * a[3]
            - two * xy * a[4]
            - two * yz * a[5]
            - six * xy * a[6];
        g[2] += xy * a[1] + eight * yz * a[2] + ring * a[3] + eight * xz * a[4] + (xx - yy) * a[5];
    }
    g
}

/// Cosine and sine of every temporal harmonic.
#[inline(always)]
fn temporal<S: Simd>(s: S, turns: f32x16<S>, degree: usize) -> ([f32x16<S>; 3], [f32x16<S>; 3]) {
    let (one, zero) = (all(s, 1.0), all(s, 0.0));
    let (mut cos, mut sin) = ([one; 3], [zero; 3]);
    if degree > 0 {
        (sin[1], cos[1]) = sin_cos_turns(s, turns);
        let twice = cos[1] + cos[1];
        cos[2] = twice * cos[1] - one;
        sin[2] = twice * sin[1];
    }
    (cos, sin)
}

/// The sums before the cut at 0.
#[inline(always)]
fn raw<S: Simd>(
    s: S,
    c: &Columns<'_>,
    row: usize,
    basis: &[f32x16<S>; 16],
    cos: &[f32x16<S>; 3],
) -> [f32x16<S>; 3] {
    let terms = c.layout.sh_terms();
    let mut sum = [all(s, 0.5); 3];
    for n in 0..=c.layout.time_degree {
        for l in 0..terms {
            let weight = basis[l] * cos[n];
            for channel in 0..3 {
                let k = load(s, &c.colour[3 * (n * terms + l) + channel], row, 0.0);
                sum[channel] = k.mul_add(weight, sum[channel]);
            }
        }
    }
    sum
}

/// Red, green and blue, at least 0 (Minute4D Eq. 2).
#[inline(always)]
pub(crate) fn shade<S: Simd>(
    s: S,
    c: &Columns<'_>,
    row: usize,
    sight: &Sight<S>,
) -> [f32x16<S>; 3] {
    let zero = all(s, 0.0);
    let mut basis = [zero; 16];
    harmonics(s, &sight.direction, c.layout.sh_terms(), &mut basis);
    let (cos, _) = temporal(s, sight.turns, c.layout.time_degree);
    let sum = raw(s, c, row, &basis, &cos);
    each!(3, k => sum[k].simd_gt(zero).select(sum[k], zero))
}

/// Writes the gradient of the coefficients to the columns of a chunk and returns what geometry
/// gets, given the gradient `g` with respect to the colours.
#[inline(always)]
pub(crate) fn backward<S: Simd>(
    s: S,
    c: &Columns<'_>,
    row: usize,
    sight: &Sight<S>,
    inverse_period: f32,
    g: &[f32x16<S>; 3],
    out: &mut [&mut [f32]],
    at: usize,
) -> SightGradient<S> {
    let zero = all(s, 0.0);
    let terms = c.layout.sh_terms();
    let mut basis = [zero; 16];
    harmonics(s, &sight.direction, terms, &mut basis);
    let (cos, sin) = temporal(s, sight.turns, c.layout.time_degree);
    let value = raw(s, c, row, &basis, &cos);
    let live: [f32x16<S>; 3] = each!(3, k => value[k].simd_gt(zero).select(g[k], zero));
    let first = c.layout.column(Column::Colour);
    let (mut pull, mut time_mean) = ([zero; 16], zero);
    for n in 0..=c.layout.time_degree {
        let mut tilt = zero;
        for l in 0..terms {
            let weight = basis[l] * cos[n];
            let mut along = zero;
            for channel in 0..3 {
                let index = 3 * (n * terms + l) + channel;
                store(weight * live[channel], out[first + index], at);
                if terms > 1 || n > 0 {
                    along = load(s, &c.colour[index], row, 0.0).mul_add(live[channel], along);
                }
            }
            pull[l] = along.mul_add(cos[n], pull[l]);
            tilt = along.mul_add(basis[l], tilt);
        }
        let omega = std::f32::consts::TAU * n as f32 * inverse_period;
        time_mean = tilt.mul_add(sin[n] * all(s, omega), time_mean);
    }
    let mut offset = [zero; 3];
    if terms > 1 {
        let d = harmonics_backward(s, &sight.direction, terms, &pull);
        let along = dot(&sight.direction, &d);
        offset = each!(3, k => (d[k] - sight.direction[k] * along) * sight.inverse_distance);
    }
    SightGradient { offset, time_mean }
}
