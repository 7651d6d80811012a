//! Projects splats of one instant to ellipses on the image, and back: slice, project and shade in one kernel, one unit per splat.

mod backward;
mod forward;

pub(crate) use backward::project_backward;
pub(crate) use forward::project;

use crate::gpu::eye::{CENTRE, FOCAL, LIMITS, MIDDLE};
use crate::gpu::vector::{V3, add_scaled, cross, dot, scaled, times, transposed, v3};
use crate::slice::gpu::Shape;
use cubecl::prelude::*;

const LOW_PASS: f32 = super::LOW_PASS as f32;

/// Numbers of a record: centre, half conic 00, conic 01, half conic 11 (times log2 e), log2 of the opacity, red, green,
/// blue, z-depth.
pub(crate) const RECORD: usize = 10;

/// What of a scene and a view is known when the kernel is compiled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct Spec {
    pub isotropic: bool,
    pub sh_terms: u32,
    pub time_terms: u32,
    pub mip: bool,
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
pub(super) fn row(eye: &[f32], #[comptime] i: usize) -> V3 {
    v3(eye[3 * i], eye[3 * i + 1], eye[3 * i + 2])
}

#[cube]
pub(super) fn offset_of(eye: &[f32], mean: &V3) -> V3 {
    // from the camera's centre first: rounding must not grow with the distance from the origin
    v3(mean.x - eye[CENTRE], mean.y - eye[CENTRE + 1], mean.z - eye[CENTRE + 2])
}

#[cube]
pub(super) fn ellipse(eye: &[f32], offset: &V3, s: &Shape, #[comptime] mip: bool) -> Ellipse {
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

#[cube]
pub(super) fn opacity_logit(geometry: &[f32], at: usize, rows: usize, #[comptime] isotropic: bool) -> f32 {
    let k = comptime!(if isotropic { 4usize } else { 10usize });
    geometry[k * rows + at]
}

/// Direction to the splat and one over its distance; zeros where colours do not depend on it.
#[cube]
pub(super) fn sight(offset: &V3, #[comptime] sh_terms: u32) -> (V3, f32) {
    let mut k = 0.0f32;
    if comptime!(sh_terms > 1) {
        k = 1.0f32 / dot(offset, offset).sqrt();
    }
    (scaled(offset, k), k)
}
