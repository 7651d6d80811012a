//! Projects splats of one instant to ellipses on the image: what the kernels of the stage
//! ([`crate::stage`]) do for one splat.

use super::{NEAR_MIN, jacobian_limits};
use crate::View;
use crate::gpu::vector::{
    BACKGROUND, CENTRE, EYE, FOCAL, INVERSE_PERIOD, LIMITS, MIDDLE, NEAR, SIZE, TIME, V3,
    add_scaled, cross, dot, scaled, times, transposed, v3,
};
use crate::slice::gpu::Shape;
use cubecl::prelude::*;

pub(crate) const LOW_PASS: f32 = super::LOW_PASS as f32;

/// `view` in the order of the constants of [`crate::gpu::vector`].
pub(crate) fn eye(view: &View) -> [f32; EYE] {
    let k = &view.camera.intrinsics;
    let (w2c, centre) = (view.camera.w2c(), view.camera.centre());
    let mut out = [0.0; EYE];
    for i in 0..9 {
        out[i] = w2c.rotation[(i / 3, i % 3)] as f32;
    }
    let mut put = |at: usize, values: &[f64]| {
        for (to, &v) in out[at..].iter_mut().zip(values) {
            *to = v as f32;
        }
    };
    put(CENTRE, &[centre.x, centre.y, centre.z]);
    put(FOCAL, &[k.fx, k.fy]);
    put(MIDDLE, &[k.cx - 0.5, k.cy - 0.5]);
    put(LIMITS, &jacobian_limits(k));
    put(TIME, &[view.t]);
    // a period of 0 means none: the harmonics are static
    let period = f64::from(view.period);
    put(
        INVERSE_PERIOD,
        &[if period > 0.0 { 1.0 / period } else { 0.0 }],
    );
    put(NEAR, &[f64::from(view.near).max(NEAR_MIN)]);
    put(SIZE, &[k.width as f64, k.height as f64]);
    put(BACKGROUND, &view.background.map(f64::from));
    out
}

/// An ellipse and what its gradient needs again.
#[derive(CubeType, Clone, Copy)]
pub(crate) struct Ellipse {
    /// Camera axes.
    pub point: V3,
    pub u: f32,
    pub v: f32,
    pub v00: f32,
    pub v01: f32,
    pub v11: f32,
    pub det: f32,
    pub sharp_det: f32,
    pub compensation: f32,
    pub ray_x: f32,
    pub ray_y: f32,
    pub slope_x: f32,
    pub slope_y: f32,
    /// Rows of Jacobian times rotation, and the same times the scaled axes.
    pub a: V3,
    pub b: V3,
    pub f: V3,
    pub g: V3,
}

#[cube]
pub(crate) fn row(eye: &[f32], #[comptime] i: usize) -> V3 {
    v3(eye[3 * i], eye[3 * i + 1], eye[3 * i + 2])
}

#[cube]
pub(crate) fn offset_of(eye: &[f32], mean: &V3) -> V3 {
    // from the camera's centre first: rounding must not grow with the distance from the origin
    v3(
        mean.x - eye[CENTRE],
        mean.y - eye[CENTRE + 1],
        mean.z - eye[CENTRE + 2],
    )
}

#[cube]
pub(crate) fn ellipse(eye: &[f32], offset: &V3, s: &Shape, #[comptime] mip: bool) -> Ellipse {
    let (w0, w1, w2) = (row(eye, 0usize), row(eye, 1usize), row(eye, 2usize));
    let point = v3(dot(&w0, offset), dot(&w1, offset), dot(&w2, offset));
    let (fx, fy) = (eye[FOCAL], eye[FOCAL + 1]);
    let iz = 1.0f32 / point.z;
    let (ray_x, ray_y) = (point.x * iz, point.y * iz);
    let slope_x = ray_x.max(eye[LIMITS]).min(eye[LIMITS + 1]);
    let slope_y = ray_y.max(eye[LIMITS + 2]).min(eye[LIMITS + 3]);
    let a = scaled(&add_scaled(&w0, -slope_x, &w2), fx * iz);
    let b = scaled(&add_scaled(&w1, -slope_y, &w2), fy * iz);
    let f = times(&transposed(&s.r0, &s.r1, &s.r2, &a), &s.scale);
    let g = times(&transposed(&s.r0, &s.r1, &s.r2, &b), &s.scale);
    let (s00, s01, s11) = (dot(&f, &f), dot(&f, &g), dot(&g, &g));
    let c = cross(&f, &g);
    let sharp_det = dot(&c, &c);
    let det = sharp_det + LOW_PASS * (s00 + s11 + LOW_PASS);
    let mut compensation = 1.0f32;
    if comptime!(mip) {
        compensation = (sharp_det / det).sqrt();
    }
    Ellipse {
        point,
        u: fx * ray_x + eye[MIDDLE],
        v: fy * ray_y + eye[MIDDLE + 1],
        v00: s00 + LOW_PASS,
        v01: s01,
        v11: s11 + LOW_PASS,
        det,
        sharp_det,
        compensation,
        ray_x,
        ray_y,
        slope_x,
        slope_y,
        a,
        b,
        f,
        g,
    }
}
