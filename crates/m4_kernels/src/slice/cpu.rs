//! The SIMD twin: sixteen splats at a time, straight from the columns.

use super::MARGINAL_MIN;
use crate::simd::{all, each, exp, load, store};
use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};
use m4_scene::{Column, SplatLayout, Splats};

/// The columns that every kernel of the splat stage reads.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Columns<'a> {
    pub(crate) layout: SplatLayout,
    pub(crate) n_static: usize,
    pub(crate) columns: &'a [Vec<f32>],
}

impl<'a> Columns<'a> {
    pub(crate) fn new(splats: &'a Splats) -> Self {
        Self {
            layout: splats.layout(),
            n_static: splats.n_static(),
            columns: splats.columns(),
        }
    }

    #[inline(always)]
    pub(crate) fn get(&self, column: Column, offset: usize) -> &'a [f32] {
        &self.columns[self.layout.column(column) + offset]
    }
}

/// What one instant sees of sixteen splats.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slice<S: Simd> {
    pub(crate) mean: [f32x16<S>; 3],
    /// Standard deviations; isotropic: all the same.
    pub(crate) scale: [f32x16<S>; 3],
    /// Columns are the axes; isotropic: zeros that nobody reads.
    pub(crate) axes: [[f32x16<S>; 3]; 3],
    /// The normalised quaternion and one over its length; isotropic: zeros.
    pub(crate) quat: [f32x16<S>; 4],
    pub(crate) quat_inverse_norm: f32x16<S>,
    /// Peak 1; 1 for static splats.
    pub(crate) marginal: f32x16<S>,
    /// `t - time_mean`, frames; 0 for static splats.
    pub(crate) dt: f32x16<S>,
    /// One over the variance in time; 0 for static splats.
    pub(crate) inverse_variance: f32x16<S>,
    /// `marginal > MARGINAL_MIN`.
    pub(crate) alive: mask32x16<S>,
}

/// Moves to the instant: mean, marginal. Cheap, so that most dynamic splats go no further.
#[inline(always)]
pub(crate) fn life<S: Simd, const DYNAMIC: bool>(s: S, c: &Columns<'_>, row: usize, t: f32) -> Slice<S> {
    let zero = all(s, 0.0);
    let mean = each!(3, k => load(s, c.get(Column::Mean, k), row, 0.0));
    let mut out = Slice {
        mean,
        scale: [zero; 3],
        axes: [[zero; 3]; 3],
        quat: [zero; 4],
        quat_inverse_norm: zero,
        marginal: all(s, 1.0),
        dt: zero,
        inverse_variance: zero,
        alive: zero.simd_eq(zero),
    };
    if DYNAMIC {
        let at = row - c.n_static;
        let dt = all(s, t) - load(s, c.get(Column::TimeMean, 0), at, 0.0);
        let log_sd = load(s, c.get(Column::LogTimeSd, 0), at, 0.0);
        let inverse_variance = exp(s, log_sd * all(s, -2.0));
        let marginal = exp(s, dt * dt * inverse_variance * all(s, -0.5));
        for k in 0..3 {
            let velocity = load(s, c.get(Column::Velocity, k), at, 0.0);
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
pub(crate) fn shape<S: Simd, const ISO: bool>(s: S, c: &Columns<'_>, row: usize, out: &mut Slice<S>) {
    if ISO {
        out.scale = [exp(s, load(s, c.get(Column::LogScale, 0), row, 0.0)); 3];
        return;
    }
    out.scale = each!(3, k => exp(s, load(s, c.get(Column::LogScale, k), row, 0.0)));
    // past the end: a quaternion of length 1, so that no lane divides by 0
    let q: [f32x16<S>; 4] = each!(4, k => load(s, c.get(Column::Quat, k), row, 0.5));
    let length = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    let inverse = all(s, 1.0) / length;
    let [w, x, y, z] = [q[0] * inverse, q[1] * inverse, q[2] * inverse, q[3] * inverse];
    let (one, two) = (all(s, 1.0), all(s, 2.0));
    out.axes = [
        [
            one - two * (y * y + z * z),
            two * (x * y - w * z),
            two * (x * z + w * y),
        ],
        [
            two * (x * y + w * z),
            one - two * (x * x + z * z),
            two * (y * z - w * x),
        ],
        [
            two * (x * z - w * y),
            two * (y * z + w * x),
            one - two * (x * x + y * y),
        ],
    ];
    out.quat = [w, x, y, z];
    out.quat_inverse_norm = inverse;
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
            let velocity = load(s, c.get(Column::Velocity, k), from, 0.0);
            time_mean -= g.mean[k] * velocity;
            store(g.mean[k] * slice.dt, out[first(Column::Velocity) + k], at);
        }
        store(time_mean, out[first(Column::TimeMean)], at);
        let log_sd = g.log_marginal * slice.dt * slice.dt * slice.inverse_variance;
        store(log_sd, out[first(Column::LogTimeSd)], at);
    }
}

/// As [`m4_math::quat::rotation_vjp`].
#[inline(always)]
fn quat_backward<S: Simd>(s: S, slice: &Slice<S>, g: &[[f32x16<S>; 3]; 3]) -> [f32x16<S>; 4] {
    let [w, x, y, z] = slice.quat;
    let two = all(s, 2.0);
    let d = [
        two * (z * (g[1][0] - g[0][1]) + y * (g[0][2] - g[2][0]) + x * (g[2][1] - g[1][2])),
        two * (y * (g[0][1] + g[1][0]) + z * (g[0][2] + g[2][0]) + w * (g[2][1] - g[1][2])
            - two * x * (g[1][1] + g[2][2])),
        two * (x * (g[0][1] + g[1][0]) + z * (g[1][2] + g[2][1]) + w * (g[0][2] - g[2][0])
            - two * y * (g[0][0] + g[2][2])),
        two * (x * (g[0][2] + g[2][0]) + y * (g[1][2] + g[2][1]) + w * (g[1][0] - g[0][1])
            - two * z * (g[0][0] + g[1][1])),
    ];
    let along = w * d[0] + x * d[1] + y * d[2] + z * d[3];
    each!(4, k => (d[k] - slice.quat[k] * along) * slice.quat_inverse_norm)
}
