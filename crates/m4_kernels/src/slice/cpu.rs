//! The SIMD version: sixteen splats at a time, straight from the columns.

use super::MARGINAL_MIN;
use crate::pose::cpu::Posed;
use crate::simd::{all, each, exp, load, store, touch};
use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};
use m4_core::{Column, SplatLayout, Splats};

/// The columns that every kernel of the splat stage reads.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Columns<'a> {
    pub(crate) layout: SplatLayout,
    pub(crate) n_static: usize,
    pub(crate) mean: [&'a [f32]; 3],
    /// Isotropic: the one scale, three times.
    pub(crate) log_scale: [&'a [f32]; 3],
    /// Isotropic: empty.
    pub(crate) quat: [&'a [f32]; 4],
    pub(crate) opacity: &'a [f32],
    /// `3 * term + channel`.
    pub(crate) colour: &'a [Vec<f32>],
    pub(crate) time_mean: &'a [f32],
    pub(crate) log_time_sd: &'a [f32],
    pub(crate) velocity: [&'a [f32]; 3],
}

impl<'a> Columns<'a> {
    /// Of bound splats, where they are carried to.
    pub(crate) fn posed(splats: &'a Splats, posed: &'a Posed) -> Self {
        let mut out = Self::new(splats);
        out.mean = posed.mean.each_ref().map(Vec::as_slice);
        if !out.layout.isotropic {
            out.quat = posed.quat.each_ref().map(Vec::as_slice);
        }
        out.opacity = &posed.opacity;
        if !posed.colour.is_empty() {
            out.colour = &posed.colour;
        }
        out
    }

    pub(crate) fn new(splats: &'a Splats) -> Self {
        let layout = splats.layout();
        let get = |column, k| splats.column(column, k);
        let scales = layout.range(Column::LogScale).len();
        Self {
            layout,
            n_static: splats.n_static(),
            mean: [0, 1, 2].map(|k| get(Column::Mean, k)),
            log_scale: [0, 1, 2].map(|k| get(Column::LogScale, k.min(scales - 1))),
            quat: [0, 1, 2, 3].map(|k| {
                if layout.isotropic {
                    &[]
                } else {
                    get(Column::Quat, k)
                }
            }),
            opacity: get(Column::Opacity, 0),
            colour: &splats.columns()[layout.range(Column::Colour)],
            time_mean: get(Column::TimeMean, 0),
            log_time_sd: get(Column::LogTimeSd, 0),
            velocity: [0, 1, 2].map(|k| get(Column::Velocity, k)),
        }
    }
}

impl Columns<'_> {
    /// Brings the next `FETCH_ROWS` rows of every column that a frame reads into the cache.
    #[inline(always)]
    pub(crate) fn fetch<const DYNAMIC: bool>(&self, row: usize) {
        touch(self.opacity, row);
        let shape = if self.layout.isotropic { 1 } else { 3 };
        let geometry = self
            .mean
            .iter()
            .chain(&self.log_scale[..shape])
            .chain(&self.quat);
        geometry.for_each(|column| touch(column, row));
        self.colour.iter().for_each(|column| touch(column, row));
        if DYNAMIC {
            let time = [self.time_mean, self.log_time_sd];
            let time = time.iter().chain(&self.velocity);
            time.for_each(|column| touch(column, row - self.n_static));
        }
    }
}

/// What one instant sees of sixteen splats.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slice<S: Simd> {
    pub(crate) mean: [f32x16<S>; 3],
    /// Standard deviations; isotropic: anyway.
    pub(crate) scale: [f32x16<S>; 3],
    /// Columns are the axes; isotropic: zeros, which are never read.
    pub(crate) axes: [[f32x16<S>; 3]; 3],
    /// The quaternion as it is and two over its square; isotropic: zeros.
    quat: [f32x16<S>; 4],
    quat_scale: f32x16<S>,
    /// Peak 1; 1 for static splats.
    pub(crate) marginal: f32x16<S>,
    /// `t - time_mean`, frames; 0 for static splats.
    pub(crate) dt: f32x16<S>,
    /// One over the variance in time; 0 for static splats.
    pub(crate) inverse_variance: f32x16<S>,
    /// `marginal > MARGINAL_MIN`.
    pub(crate) alive: mask32x16<S>,
}

/// Whether one of sixteen dynamic splats may be there at `t`, from the two columns that decide it
/// and with one power: most splats of a long video are not, and eight bytes of them are all that is
/// read.
#[inline(always)]
pub(crate) fn any_alive<S: Simd>(s: S, c: &Columns<'_>, row: usize, t: f32) -> bool {
    let at = row - c.n_static;
    let dt = all(s, t) - load(s, c.time_mean, at, 0.0);
    let log_sd = load(s, c.log_time_sd, at, 0.0);
    // p > MARGINAL_MIN means dt^2 < -2 ln(MARGINAL_MIN) sd^2; the rest of 6 covers the rounding
    (dt * dt)
        .simd_le(all(s, 6.0) * exp(s, log_sd + log_sd))
        .any_true()
}

/// The place in time of sixteen dynamic splats.
#[derive(Debug, Clone, Copy)]
struct Moment<S: Simd> {
    dt: f32x16<S>,
    inverse_variance: f32x16<S>,
    marginal: f32x16<S>,
}

#[inline(always)]
fn marginal<S: Simd>(s: S, c: &Columns<'_>, at: usize, t: f32) -> Moment<S> {
    let dt = all(s, t) - load(s, c.time_mean, at, 0.0);
    let log_sd = load(s, c.log_time_sd, at, 0.0);
    let inverse_variance = exp(s, log_sd * all(s, -2.0));
    Moment {
        dt,
        inverse_variance,
        marginal: exp(s, dt * dt * inverse_variance * all(s, -0.5)),
    }
}

/// Moves to the instant: mean, marginal (Minute4D Eq. 1). Cheap, so that most dynamic splats go no
/// further.
#[inline(always)]
pub(crate) fn life<S: Simd, const DYNAMIC: bool>(
    s: S,
    c: &Columns<'_>,
    row: usize,
    t: f32,
) -> Slice<S> {
    let zero = all(s, 0.0);
    let mean = each!(3, k => load(s, c.mean[k], row, 0.0));
    let mut out = Slice {
        mean,
        scale: [zero; 3],
        axes: [[zero; 3]; 3],
        quat: [zero; 4],
        quat_scale: zero,
        marginal: all(s, 1.0),
        dt: zero,
        inverse_variance: zero,
        alive: zero.simd_eq(zero),
    };
    if DYNAMIC {
        let at = row - c.n_static;
        let Moment {
            dt,
            inverse_variance,
            marginal,
        } = marginal(s, c, at, t);
        for k in 0..3 {
            let velocity = load(s, c.velocity[k], at, 0.0);
            out.mean[k] = velocity.mul_add(dt, out.mean[k]);
        }
        out.alive = marginal.simd_gt(all(s, MARGINAL_MIN as f32));
        out.dt = dt;
        out.inverse_variance = inverse_variance;
        out.marginal = marginal;
    }
    out
}

/// Size and orientation.
#[inline(always)]
pub(crate) fn shape<S: Simd, const ISO: bool>(
    s: S,
    c: &Columns<'_>,
    row: usize,
    out: &mut Slice<S>,
) {
    if ISO {
        out.scale = [exp(s, load(s, c.log_scale[0], row, 0.0)); 3];
        return;
    }
    out.scale = each!(3, k => exp(s, load(s, c.log_scale[k], row, 0.0)));
    // past the end: a quaternion of length 1, so that no lane divides by 0
    let q: [f32x16<S>; 4] = each!(4, k => load(s, c.quat[k], row, 0.5));
    let [w, x, y, z] = q;
    let one = all(s, 1.0);
    // no root: every entry is a product of two, so the square of the length divides it
    let scale = all(s, 2.0) / (w * w + x * x + y * y + z * z);
    let (sx, sy, sz) = (scale * x, scale * y, scale * z);
    let (xx, yy, zz) = (sx * x, sy * y, sz * z);
    let (xy, xz, yz) = (sx * y, sx * z, sy * z);
    let (wx, wy, wz) = (sx * w, sy * w, sz * w);
    out.axes = [
        [one - (yy + zz), xy - wz, xz + wy],
        [xy + wz, one - (xx + zz), yz - wx],
        [xz - wy, yz + wx, one - (xx + yy)],
    ];
    out.quat = q;
    out.quat_scale = scale;
}

/// The gradient with respect to what [`life`] and [`shape`] give.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SliceGradient<S: Simd> {
    pub(crate) mean: [f32x16<S>; 3],
    pub(crate) log_scale: [f32x16<S>; 3],
    pub(crate) axes: [[f32x16<S>; 3]; 3],
    /// With respect to the logarithm of the marginal.
    pub(crate) log_marginal: f32x16<S>,
    /// Reaches `time_mean` by another way: the colour.
    pub(crate) time_mean: f32x16<S>,
}

/// Writes the gradient of the geometry to the columns of a chunk whose first row is `chunk_row`.
#[inline(always)]
pub(crate) fn backward<S: Simd, const DYNAMIC: bool, const ISO: bool>(
    s: S,
    c: &Columns<'_>,
    row: usize,
    slice: &Slice<S>,
    g: &SliceGradient<S>,
    out: &mut [&mut [f32]],
    at: usize,
) {
    let first = |column| c.layout.column(column);
    for k in 0..3 {
        store(g.mean[k], out[first(Column::Mean) + k], at);
    }
    if ISO {
        store(g.log_scale[0], out[first(Column::LogScale)], at);
    } else {
        for k in 0..3 {
            store(g.log_scale[k], out[first(Column::LogScale) + k], at);
        }
        let d = quat_backward(s, slice, &g.axes);
        for k in 0..4 {
            store(d[k], out[first(Column::Quat) + k], at);
        }
    }
    if DYNAMIC {
        let from = row - c.n_static;
        let mut time_mean = g.time_mean + g.log_marginal * slice.dt * slice.inverse_variance;
        for k in 0..3 {
            let velocity = load(s, c.velocity[k], from, 0.0);
            time_mean -= g.mean[k] * velocity;
            store(g.mean[k] * slice.dt, out[first(Column::Velocity) + k], at);
        }
        store(time_mean, out[first(Column::TimeMean)], at);
        let log_sd = g.log_marginal * slice.dt * slice.dt * slice.inverse_variance;
        store(log_sd, out[first(Column::LogTimeSd)], at);
    }
}

/// As [`m4_core::quat::rotation_vjp`], with `R = I + scale B(q)`, `scale = 2 / |q|^2`: the
/// derivative of the products less the part along `q`, which the scale takes off.
#[inline(always)]
fn quat_backward<S: Simd>(s: S, slice: &Slice<S>, g: &[[f32x16<S>; 3]; 3]) -> [f32x16<S>; 4] {
    let [w, x, y, z] = slice.quat;
    let two = all(s, 2.0);
    let (xy, xz, yz) = (g[0][1] + g[1][0], g[0][2] + g[2][0], g[1][2] + g[2][1]);
    let (wx, wy, wz) = (g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]);
    let d = [
        x * wx + y * wy + z * wz,
        y * xy + z * xz + w * wx - two * x * (g[1][1] + g[2][2]),
        x * xy + z * yz + w * wy - two * y * (g[0][0] + g[2][2]),
        x * xz + y * yz + w * wz - two * z * (g[0][0] + g[1][1]),
    ];
    let scale = slice.quat_scale;
    // scaled before it is multiplied: a length that overflows must not make its gradient NaN
    let unit: [f32x16<S>; 4] = each!(4, k => scale * all(s, 0.5) * slice.quat[k]);
    let along = unit[0] * d[0] + unit[1] * d[1] + unit[2] * d[2] + unit[3] * d[3];
    each!(4, k => scale * (d[k] - slice.quat[k] * along))
}
