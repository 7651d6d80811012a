//! The SIMD version: sixteen ellipses at a time.

use super::{LOW_PASS, NEAR_MIN, jacobian_limits};
use crate::{
    View,
    simd::{all, all3, dot, each},
    slice::cpu::Slice,
};
use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};

/// A camera in the precision of the twins.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Eye {
    /// Rows of the rotation from world to camera.
    pub(crate) rotation: [[f32; 3]; 3],
    /// The camera's centre in the world. Points are turned after it is taken off, so that rounding
    /// does not grow with the distance from the origin.
    pub(crate) centre: [f32; 3],
    pub(crate) fx: f32,
    pub(crate) fy: f32,
    /// Principal point, pixels, the centre of the first pixel at 0.
    pub(crate) u0: f32,
    pub(crate) v0: f32,
    /// See [`jacobian_limits`].
    pub(crate) limits: [f32; 4],
    pub(crate) near: f32,
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) t: f32,
    pub(crate) inverse_period: f32,
    pub(crate) mip: bool,
}

impl Eye {
    pub(crate) fn new(view: &View) -> Self {
        let k = &view.camera.intrinsics;
        let (w2c, centre) = (view.camera.w2c(), view.camera.centre());
        Self {
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| w2c.rotation[(i, j)] as f32)),
            centre: centre.map(|v| v as f32).into(),
            fx: k.fx as f32,
            fy: k.fy as f32,
            u0: (k.cx - 0.5) as f32,
            v0: (k.cy - 0.5) as f32,
            limits: jacobian_limits(k).map(|v| v as f32),
            near: view.near.max(NEAR_MIN as f32),
            width: k.width,
            height: k.height,
            t: view.t as f32,
            // a period of 0 means none: the harmonics are static
            inverse_period: if view.period > 0.0 {
                1.0 / view.period
            } else {
                0.0
            },
            mip: view.mip,
        }
    }
}

/// Where sixteen splats are, as the camera sees them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place<S: Simd> {
    /// From the camera's centre, world axes.
    pub(crate) offset: [f32x16<S>; 3],
    /// Camera axes.
    pub(crate) point: [f32x16<S>; 3],
}

/// Turns means into camera coordinates.
#[inline(always)]
pub(crate) fn place<S: Simd>(s: S, eye: &Eye, mean: &[f32x16<S>; 3]) -> Place<S> {
    let offset = each!(3, k => mean[k] - all(s, eye.centre[k]));
    let point = each!(3, i => dot(&all3(s, &eye.rotation[i]), &offset));
    Place { offset, point }
}

/// Sixteen ellipses and what their gradient needs again.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ellipse<S: Simd> {
    /// Pixels.
    pub(crate) u: f32x16<S>,
    pub(crate) v: f32x16<S>,
    /// Low-passed covariance `(00, 01, 11)`, its determinant, its inverse.
    pub(crate) covariance: [f32x16<S>; 3],
    pub(crate) det: f32x16<S>,
    pub(crate) conic: [f32x16<S>; 3],
    pub(crate) compensation: f32x16<S>,
    /// Without the low pass, and its determinant.
    sharp: [f32x16<S>; 3],
    sharp_det: f32x16<S>,
    inverse_z: f32x16<S>,
    /// `x / z`, `y / z`, and where the Jacobian is evaluated.
    ray: [f32x16<S>; 2],
    slope: [f32x16<S>; 2],
    /// Jacobian times rotation, `[2][3]`.
    jw: [[f32x16<S>; 3]; 2],
    /// The same times the scaled axes; isotropic: the same times the scale.
    factor: [[f32x16<S>; 3]; 2],
}

/// Projects the shapes.
#[inline(always)]
pub(crate) fn ellipse<S: Simd, const ISO: bool>(
    s: S,
    eye: &Eye,
    place: &Place<S>,
    slice: &Slice<S>,
) -> Ellipse<S> {
    let k = |v: f32| all(s, v);
    let [x, y, z] = place.point;
    let inverse_z = k(1.0) / z;
    let ray = [x * inverse_z, y * inverse_z];
    let slope = [
        ray[0].max(k(eye.limits[0])).min(k(eye.limits[1])),
        ray[1].max(k(eye.limits[2])).min(k(eye.limits[3])),
    ];
    let (jx, jy) = (k(eye.fx) * inverse_z, k(eye.fy) * inverse_z);
    let w: [_; 3] = each!(3, i => all3(s, &eye.rotation[i]));
    let jw = [
        each!(3, i => jx * (w[0][i] - slope[0] * w[2][i])),
        each!(3, i => jy * (w[1][i] - slope[1] * w[2][i])),
    ];
    let factor: [[f32x16<S>; 3]; 2] = if ISO {
        each!(2, r => each!(3, c => jw[r][c] * slice.scale[0]))
    } else {
        let axis: [[f32x16<S>; 3]; 3] =
            each!(3, c => [slice.axes[0][c], slice.axes[1][c], slice.axes[2][c]]);
        each!(2, r => each!(3, c => dot(&jw[r], &axis[c]) * slice.scale[c]))
    };
    let sharp = [
        dot(&factor[0], &factor[0]),
        dot(&factor[0], &factor[1]),
        dot(&factor[1], &factor[1]),
    ];
    let low = k(LOW_PASS as f32);
    let covariance = [sharp[0] + low, sharp[1], sharp[2] + low];
    // (a + l)(c + l) - b^2 with the small terms apart: a long thin ellipse cancels in a c - b^2,
    // and Gram's identity gives that part as a sum of squares
    let cross = [
        factor[0][1] * factor[1][2] - factor[0][2] * factor[1][1],
        factor[0][2] * factor[1][0] - factor[0][0] * factor[1][2],
        factor[0][0] * factor[1][1] - factor[0][1] * factor[1][0],
    ];
    let sharp_det = dot(&cross, &cross);
    let det = low.mul_add(sharp[0] + sharp[2] + low, sharp_det);
    let inverse = k(1.0) / det;
    let compensation = if eye.mip {
        (sharp_det * inverse).sqrt()
    } else {
        k(1.0)
    };
    Ellipse {
        u: (k(eye.fx) * ray[0]) + k(eye.u0),
        v: (k(eye.fy) * ray[1]) + k(eye.v0),
        covariance,
        det,
        conic: [
            covariance[2] * inverse,
            -(covariance[1] * inverse),
            covariance[0] * inverse,
        ],
        compensation,
        sharp,
        sharp_det,
        inverse_z,
        ray,
        slope,
        jw,
        factor,
    }
}

/// The sums over pixels that a splat's gradient is made of (docs/spec/optimiser.md 1.7), with
/// `omega = dL/d(alpha) alpha` (0 where alpha was cut) and `d = centre - pixel`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Moments<S: Simd> {
    /// Sum of omega: the gradient with respect to the logarithm of the opacity.
    pub(crate) weight: f32x16<S>,
    /// Sums of `omega dx`, `omega dy`.
    pub(crate) first: [f32x16<S>; 2],
    /// Sums of `omega dx dx`, `omega dx dy`, `omega dy dy`.
    pub(crate) second: [f32x16<S>; 3],
}

/// What the projection passes back.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PlaceGradient<S: Simd> {
    /// Pixels: the projected centre.
    pub(crate) centre: [f32x16<S>; 2],
    /// With respect to the point in camera axes.
    pub(crate) point: [f32x16<S>; 3],
    /// With respect to the mean in world axes, through the projection alone.
    pub(crate) mean: [f32x16<S>; 3],
    pub(crate) log_scale: [f32x16<S>; 3],
    pub(crate) axes: [[f32x16<S>; 3]; 3],
    /// With respect to every entry of the Jacobian `[2][3]`, the structural zeros too: the twist
    /// turns them.
    d_j: [[f32x16<S>; 3]; 2],
}

/// What a camera's own gradient gets through a splat's place and shape.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LensGradient<S: Simd> {
    /// Rotation part of the left twist.
    pub(crate) omega: [f32x16<S>; 3],
    /// `fx, fy`.
    pub(crate) focal: [f32x16<S>; 2],
}

/// The gradient with respect to place and shape; lanes whose moments are 0 get 0 as long as their
/// ellipse is finite.
#[inline(always)]
pub(crate) fn backward<S: Simd, const ISO: bool>(
    s: S,
    eye: &Eye,
    slice: &Slice<S>,
    e: &Ellipse<S>,
    m: &Moments<S>,
) -> PlaceGradient<S> {
    let k = |v: f32| all(s, v);
    let (zero, half, two) = (k(0.0), k(0.5), k(2.0));
    let [a, b, c] = e.conic;
    let centre = [
        -(a * m.first[0] + b * m.first[1]),
        -(b * m.first[0] + c * m.first[1]),
    ];
    // G = A M A / 2
    let [xx, xy, yy] = m.second;
    let p = [
        [a * xx + b * xy, a * xy + b * yy],
        [b * xx + c * xy, b * xy + c * yy],
    ];
    let mut g = [
        half * (p[0][0] * a + p[0][1] * b),
        half * (p[0][0] * b + p[0][1] * c),
        half * (p[1][0] * b + p[1][1] * c),
    ];
    if eye.mip {
        let det = e.sharp_det;
        let ok = det.simd_gt(k(f32::MIN_POSITIVE));
        let inverse = ok.select(k(1.0) / det, zero);
        let weight = ok.select(half * m.weight, zero);
        g[0] += weight * (e.sharp[2] * inverse - a);
        g[1] += weight * (-(e.sharp[1] * inverse) - b);
        g[2] += weight * (e.sharp[0] * inverse - c);
    }
    let d_factor: [[f32x16<S>; 3]; 2] = [
        each!(3, i => two * (g[0] * e.factor[0][i] + g[1] * e.factor[1][i])),
        each!(3, i => two * (g[1] * e.factor[0][i] + g[2] * e.factor[1][i])),
    ];
    let mut log_scale: [f32x16<S>; 3] =
        each!(3, i => d_factor[0][i] * e.factor[0][i] + d_factor[1][i] * e.factor[1][i]);
    let mut axes = [[zero; 3]; 3];
    let d_jw: [[f32x16<S>; 3]; 2];
    if ISO {
        log_scale[0] = log_scale[0] + log_scale[1] + log_scale[2];
        d_jw = each!(2, r => each!(3, i => d_factor[r][i] * slice.scale[0]));
    } else {
        let scaled: [[f32x16<S>; 3]; 2] =
            each!(2, r => each!(3, i => d_factor[r][i] * slice.scale[i]));
        d_jw = each!(2, r => each!(3, i => dot(&scaled[r], &slice.axes[i])));
        for i in 0..3 {
            for j in 0..3 {
                axes[i][j] = e.jw[0][i] * scaled[0][j] + e.jw[1][i] * scaled[1][j];
            }
        }
    }
    let w: [_; 3] = each!(3, i => all3(s, &eye.rotation[i]));
    let d_j: [[f32x16<S>; 3]; 2] = each!(2, r => each!(3, j => dot(&d_jw[r], &w[j])));
    let (iz, ray, slope) = (e.inverse_z, e.ray, e.slope);
    let (jx, jy) = (k(eye.fx) * iz, k(eye.fy) * iz);
    let mut point = [
        centre[0] * jx,
        centre[1] * jy,
        -(centre[0] * jx * ray[0] + centre[1] * jy * ray[1])
            - (d_j[0][0] * jx + d_j[1][1] * jy) * iz,
    ];
    for (axis, j) in [(0, jx), (1, jy)] {
        let d = d_j[axis][2] * j * iz;
        let free = slope[axis].simd_eq(ray[axis]);
        point[axis] -= free.select(d, zero);
        point[2] += d * slope[axis] * free.select(two, k(1.0));
    }
    PlaceGradient {
        centre,
        point,
        mean: each!(3, i => w[0][i] * point[0] + w[1][i] * point[1] + w[2][i] * point[2]),
        log_scale,
        axes,
        d_j,
    }
}

/// The gradient with respect to the camera, from that with respect to place and shape.
#[inline(always)]
pub(crate) fn lens_backward<S: Simd>(
    s: S,
    eye: &Eye,
    place: &Place<S>,
    e: &Ellipse<S>,
    d: &PlaceGradient<S>,
) -> LensGradient<S> {
    let ([x, y, z], (iz, ray, slope)) = (place.point, (e.inverse_z, e.ray, e.slope));
    let (point, centre, d_j) = (&d.point, &d.centre, &d.d_j);
    let (jx, jy) = (all(s, eye.fx) * iz, all(s, eye.fy) * iz);
    let (j02, j12) = (-(jx * slope[0]), -(jy * slope[1]));
    LensGradient {
        omega: [
            y * point[2] - z * point[1] + j02 * d_j[0][1] + j12 * d_j[1][1] - jy * d_j[1][2],
            z * point[0] - x * point[2] + jx * d_j[0][2] - j02 * d_j[0][0] - j12 * d_j[1][0],
            x * point[1] - y * point[0] + jy * d_j[1][0] - jx * d_j[0][1],
        ],
        focal: [
            centre[0] * ray[0] + (d_j[0][0] - d_j[0][2] * slope[0]) * iz,
            centre[1] * ray[1] + (d_j[1][1] - d_j[1][2] * slope[1]) * iz,
        ],
    }
}

/// Lanes whose ellipse is a set of finite numbers.
#[inline(always)]
pub(crate) fn finite<S: Simd>(s: S, e: &Ellipse<S>, opacity: f32x16<S>) -> mask32x16<S> {
    // v * 0 is 0 for finite v, and NaN otherwise
    let sum =
        (e.u + e.v) * all(s, 0.0) + (e.conic[0] + e.conic[1] + e.conic[2] + opacity) * all(s, 0.0);
    sum.simd_eq(all(s, 0.0)) & e.det.simd_gt(all(s, 0.0))
}
