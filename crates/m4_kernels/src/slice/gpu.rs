//! A 4D splat at one instant, forward and backward.

#![expect(
    missing_docs,
    reason = "`cube` generates items beside those that it is written at"
)]

use crate::gpu::vector::{V3, v3};
use cubecl::prelude::*;

/// Where a splat is and whether it is there.
#[derive(CubeType, Clone, Copy)]
pub(crate) struct Life {
    pub mean: V3,
    /// `t - time_mean`, frames; 0 for static splats.
    pub dt: f32,
    pub inverse_variance: f32,
    pub marginal: f32,
}

/// Size and orientation.
#[derive(CubeType, Clone, Copy)]
pub struct Shape {
    /// Standard deviations.
    pub scale: V3,
    /// Rows of the rotation.
    pub r0: V3,
    /// Second row.
    pub r1: V3,
    /// Third row.
    pub r2: V3,
    /// Real part of the quaternion as it is stored.
    pub w: f32,
    /// Its other parts.
    pub q: V3,
    /// Two over the squared length of the quaternion.
    pub k: f32,
}

/// Where what is drawn of a bound splat lies.
#[derive(CubeType, Clone, Copy)]
pub(crate) struct Carried {
    /// Whether the splat is one.
    pub on: bool,
    pub at: usize,
    /// Bound splats.
    pub rows: usize,
}

/// Whether splat `i` is bound: rows from `n_static` to `n_still`.
#[cube]
pub(crate) fn carried(i: u32, n_static: u32, n_still: u32) -> Carried {
    Carried {
        on: i >= n_static && i < n_still,
        at: (i - n_static) as usize,
        rows: (n_still - n_static) as usize,
    }
}

/// A column of what is drawn of a bound splat.
#[cube]
pub(crate) fn posed_number(posed: &[f32], carried: &Carried, #[comptime] column: usize) -> f32 {
    posed[column * carried.rows + carried.at]
}

/// Moves splat `i` to the instant `t` (Minute4D Eq. 1); one that is bound is there already.
#[cube]
pub(crate) fn life(
    geometry: &[f32],
    time: &[f32],
    posed: &[f32],
    carried: &Carried,
    i: u32,
    n: u32,
    n_static: u32,
    n_still: u32,
    t: f32,
    #[comptime] bound: bool,
) -> Life {
    let at = i as usize;
    let rows = n as usize;
    let mut x = geometry[at];
    let mut y = geometry[rows + at];
    let mut z = geometry[2 * rows + at];
    let mut marginal = 1.0f32;
    let mut dt = 0.0f32;
    let mut inverse_variance = 0.0f32;
    if comptime!(bound) {
        if carried.on {
            x = posed_number(posed, carried, 0usize);
            y = posed_number(posed, carried, 1usize);
            z = posed_number(posed, carried, 2usize);
        }
    }
    if i >= n_still {
        let j = (i - n_static) as usize;
        let dynamic = (n - n_static) as usize;
        dt = t - time[j];
        inverse_variance = (-2.0f32 * time[dynamic + j]).exp();
        marginal = (-0.5f32 * dt * dt * inverse_variance).exp();
        x += time[2 * dynamic + j] * dt;
        y += time[3 * dynamic + j] * dt;
        z += time[4 * dynamic + j] * dt;
    }
    Life {
        mean: v3(x, y, z),
        dt,
        inverse_variance,
        marginal,
    }
}

/// Scales and axes of splat `i`, as it is stored.
#[cube]
pub fn shape(geometry: &[f32], i: u32, n: u32, #[comptime] isotropic: bool) -> Shape {
    drawn_shape(
        geometry,
        geometry,
        &carried(i, 0u32, 0u32),
        i,
        n,
        isotropic,
        false,
    )
}

/// Scales and axes of splat `i`, as it is drawn.
#[cube]
pub(crate) fn drawn_shape(
    geometry: &[f32],
    posed: &[f32],
    carried: &Carried,
    i: u32,
    n: u32,
    #[comptime] isotropic: bool,
    #[comptime] bound: bool,
) -> Shape {
    let at = i as usize;
    let rows = n as usize;
    if comptime!(isotropic) {
        let s = geometry[3 * rows + at].exp();
        Shape {
            scale: v3(s, s, s),
            r0: v3(1.0f32, 0.0f32, 0.0f32),
            r1: v3(0.0f32, 1.0f32, 0.0f32),
            r2: v3(0.0f32, 0.0f32, 1.0f32),
            w: f32::new(1.0f32),
            q: v3(0.0f32, 0.0f32, 0.0f32),
            k: f32::new(2.0f32),
        }
    } else {
        let scale = v3(
            geometry[3 * rows + at].exp(),
            geometry[4 * rows + at].exp(),
            geometry[5 * rows + at].exp(),
        );
        let mut w = geometry[6 * rows + at];
        let mut x = geometry[7 * rows + at];
        let mut y = geometry[8 * rows + at];
        let mut z = geometry[9 * rows + at];
        if comptime!(bound) {
            if carried.on {
                w = posed_number(posed, carried, 3usize);
                x = posed_number(posed, carried, 4usize);
                y = posed_number(posed, carried, 5usize);
                z = posed_number(posed, carried, 6usize);
            }
        }
        let k = 2.0f32 / (w * w + x * x + y * y + z * z);
        Shape {
            scale,
            r0: v3(
                1.0f32 - k * (y * y + z * z),
                k * (x * y - w * z),
                k * (x * z + w * y),
            ),
            r1: v3(
                k * (x * y + w * z),
                1.0f32 - k * (x * x + z * z),
                k * (y * z - w * x),
            ),
            r2: v3(
                k * (x * z - w * y),
                k * (y * z + w * x),
                1.0f32 - k * (x * x + y * y),
            ),
            w,
            q: v3(x, y, z),
            k,
        }
    }
}

/// Writes the gradient of the quaternion, given that of the rotation's rows.
#[cube]
pub(crate) fn quat_backward(
    s: &Shape,
    g0: &V3,
    g1: &V3,
    g2: &V3,
    out: &mut [f32],
    at: usize,
    rows: usize,
) {
    let (w, x, y, z) = (s.w, s.q.x, s.q.y, s.q.z);
    let (xy, xz, yz) = (g0.y + g1.x, g0.z + g2.x, g1.z + g2.y);
    let (wx, wy, wz) = (g2.y - g1.z, g0.z - g2.x, g1.x - g0.y);
    let dw = x * wx + y * wy + z * wz;
    let dx = y * xy + z * xz + w * wx - 2.0f32 * x * (g1.y + g2.z);
    let dy = x * xy + z * yz + w * wy - 2.0f32 * y * (g0.x + g2.z);
    let dz = x * xz + y * yz + w * wz - 2.0f32 * z * (g0.x + g1.y);
    let half = 0.5f32 * s.k;
    // scaled before it is multiplied: a length that overflows must not make its gradient NaN
    let along = half * w * dw + half * x * dx + half * y * dy + half * z * dz;
    out[6 * rows + at] = s.k * (dw - w * along);
    out[7 * rows + at] = s.k * (dx - x * along);
    out[8 * rows + at] = s.k * (dy - y * along);
    out[9 * rows + at] = s.k * (dz - z * along);
}
