//! Poses of nodes at an instant, and the splats that they carry.

use super::LEAST;
use super::moment::{FIRST, HALF, NODES, ON, POSES, SHARE, WEIGHTS, WINDOW};
use crate::gpu::vector::{CENTRE, TIME, V3, v3};
use crate::splats::{LIFE, MOTION, NODE, POSE, WEIGHT};
use cubecl::prelude::*;

/// A quaternion.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Quat {
    pub w: f32,
    pub x: f32,
    pub y: f32,
    pub z: f32,
}

#[cube]
pub(super) fn quat(w: f32, x: f32, y: f32, z: f32) -> Quat {
    Quat { w, x, y, z }
}

#[cube]
pub(super) fn conjugate(q: &Quat) -> Quat {
    quat(q.w, -q.x, -q.y, -q.z)
}

#[cube]
pub(super) fn product(a: &Quat, b: &Quat) -> Quat {
    quat(
        a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
        a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
        a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
        a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
    )
}

/// Four numbers from `at` on.
#[cube]
pub(super) fn quat_at(numbers: &[f32], at: usize) -> Quat {
    quat(
        numbers[at],
        numbers[at + 1],
        numbers[at + 2],
        numbers[at + 3],
    )
}

#[cube]
pub(super) fn v3_at(numbers: &[f32], at: usize) -> V3 {
    v3(numbers[at], numbers[at + 1], numbers[at + 2])
}

/// A number of row `at` of a column of `rows`.
#[cube]
pub(super) fn in_column(numbers: &[f32], column: u32, rows: usize, at: usize) -> f32 {
    numbers[column as usize * rows + at]
}

#[cube]
pub(super) fn v3_in(numbers: &[f32], column: u32, rows: usize, at: usize) -> V3 {
    v3(
        in_column(numbers, column, rows, at),
        in_column(numbers, column + 1u32, rows, at),
        in_column(numbers, column + 2u32, rows, at),
    )
}

/// A number of a window.
#[cube]
pub(super) fn of_window(table: &[u32], window: usize, #[comptime] number: usize) -> u32 {
    table[window * WINDOW + number]
}

/// The motion of every node of the windows that splats may be present of, one unit a node:
/// quaternion, matrix, shift.
#[cube(launch)]
pub(super) fn move_nodes(
    poses: &[f32],
    anchors: &[f32],
    table: &[u32],
    motions: &mut [f32],
    list: u32,
    active: u32,
    most: u32,
) {
    let i = ABSOLUTE_POS as u32;
    if i < active * most {
        let window = table[(list + i / most) as usize] as usize;
        let node = i % most;
        if node < of_window(table, window, NODES) {
            let mut x = 0.0f32;
            let mut y = 0.0f32;
            let mut z = 0.0f32;
            #[unroll]
            for k in 0usize..4usize {
                let weight = f32::reinterpret(of_window(table, window, comptime!(WEIGHTS + k)));
                if weight != 0.0f32 {
                    let from =
                        (of_window(table, window, comptime!(POSES + k)) + node) as usize * POSE;
                    x += weight * poses[from];
                    y += weight * poses[from + 1];
                    z += weight * poses[from + 2];
                }
            }
            let a = (of_window(table, window, comptime!(POSES + 1)) + node) as usize * POSE + 3;
            let b = (of_window(table, window, comptime!(POSES + 2)) + node) as usize * POSE + 3;
            let share = f32::reinterpret(of_window(table, window, SHARE));
            let q = turned(&quat_at(poses, a), &quat_at(poses, b), share);
            let k = 2.0f32 / (q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
            let r0 = v3(
                1.0f32 - k * (q.y * q.y + q.z * q.z),
                k * (q.x * q.y - q.w * q.z),
                k * (q.x * q.z + q.w * q.y),
            );
            let r1 = v3(
                k * (q.x * q.y + q.w * q.z),
                1.0f32 - k * (q.x * q.x + q.z * q.z),
                k * (q.y * q.z - q.w * q.x),
            );
            let r2 = v3(
                k * (q.x * q.z - q.w * q.y),
                k * (q.y * q.z + q.w * q.x),
                1.0f32 - k * (q.x * q.x + q.y * q.y),
            );
            let index = (of_window(table, window, FIRST) + node) as usize;
            let from = v3_at(anchors, index * 3);
            let to = index * MOTION;
            motions[to] = q.w;
            motions[to + 1] = q.x;
            motions[to + 2] = q.y;
            motions[to + 3] = q.z;
            motions[to + 4] = r0.x;
            motions[to + 5] = r0.y;
            motions[to + 6] = r0.z;
            motions[to + 7] = r1.x;
            motions[to + 8] = r1.y;
            motions[to + 9] = r1.z;
            motions[to + 10] = r2.x;
            motions[to + 11] = r2.y;
            motions[to + 12] = r2.z;
            motions[to + 13] = x - (r0.x * from.x + r0.y * from.y + r0.z * from.z);
            motions[to + 14] = y - (r1.x * from.x + r1.y * from.y + r1.z * from.z);
            motions[to + 15] = z - (r2.x * from.x + r2.y * from.y + r2.z * from.z);
        }
    }
}

/// `a` turned towards `b` by a share of the shortest turn between them.
#[cube]
fn turned(a: &Quat, b: &Quat, share: f32) -> Quat {
    let turn = product(b, &conjugate(a));
    let length = (turn.x * turn.x + turn.y * turn.y + turn.z * turn.z).sqrt();
    let mut cos = 1.0f32;
    let mut along = 0.0f32;
    if share != 0.0f32 && length > 0.0f32 {
        let angle = share * length.atan2(turn.w.abs());
        cos = angle.cos();
        along = angle.sin() / length;
        if turn.w < 0.0f32 {
            along = -along;
        }
    }
    product(
        &quat(cos, along * turn.x, along * turn.y, along * turn.z),
        a,
    )
}

/// How much of bound splat `j` is there at `t`; 0 where it is left out.
#[cube]
pub(super) fn presence(bindings: &[u32], table: &[u32], j: usize, n: usize, t: f32) -> f32 {
    let window = bindings[j] as usize;
    let half = f32::reinterpret(of_window(table, window, HALF));
    let begin = f32::reinterpret(bindings[LIFE * n + j]);
    let end = f32::reinterpret(bindings[(LIFE + 1) * n + j]);
    let a = (0.5f32 + 0.5f32 * ((t - begin) / half)).clamp(0.0f32, 1.0f32);
    let b = (0.5f32 + 0.5f32 * ((end - t) / half)).clamp(0.0f32, 1.0f32);
    let mut present = a * a * (3.0f32 - 2.0f32 * a) * (b * b * (3.0f32 - 2.0f32 * b));
    if present < LEAST || of_window(table, window, ON) == 0u32 {
        present = 0.0f32;
    }
    present
}

/// 1, or -1 where a node's quaternion lies opposite to that of the first node.
#[cube]
pub(super) fn side(motions: &[f32], first: usize, node: usize) -> f32 {
    let (a, b) = (
        quat_at(motions, first * MOTION),
        quat_at(motions, node * MOTION),
    );
    let mut side = 1.0f32;
    if a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z < 0.0f32 {
        side = f32::new(-1.0f32);
    }
    side
}

/// The mean motion of the nodes of bound splat `j`: as that of one node.
#[cube]
pub(super) fn carrier(bindings: &[u32], motions: &[f32], j: usize, n: usize) -> Array<f32> {
    let mut sum = Array::<f32>::new(MOTION);
    #[unroll]
    for m in 0usize..MOTION {
        sum[m] = f32::new(0.0f32);
    }
    let first = bindings[NODE * n + j] as usize;
    #[unroll]
    for k in 0usize..4usize {
        let node = bindings[(NODE + k) * n + j] as usize;
        let weight = f32::reinterpret(bindings[(WEIGHT + k) * n + j]);
        let turn = weight * side(motions, first, node);
        #[unroll]
        for m in 0usize..MOTION {
            let mut share = weight;
            if comptime!(m < 4) {
                share = turn;
            }
            sum[m] += share * motions[node * MOTION + m];
        }
    }
    sum
}

/// `ln(1 + x)` of `x >= 0`.
#[cube]
fn ln_1p(x: f32) -> f32 {
    let mut out = (1.0f32 + x).ln();
    if x < 0.05f32 {
        out = x * (1.0f32 - x * (0.5f32 - x * (1.0f32 / 3.0f32 - x * (0.25f32 - 0.2f32 * x))));
    }
    out
}

/// `1 - exp(-x)` of `x >= 0`.
#[cube]
fn one_less_exp(x: f32) -> f32 {
    let mut out = 1.0f32 - (-x).exp();
    if x < 0.1f32 {
        out = x
            * (1.0f32
                - x * (0.5f32
                    - x * (1.0f32 / 6.0f32 - x * (1.0f32 / 24.0f32 - x * (1.0f32 / 120.0f32)))));
    }
    out
}

/// `-f ln(1 - o)` and `1 - (1 - o)^f`, where `logit` is that of `o`.
#[cube]
fn faint(logit: f32, f: f32) -> (f32, f32) {
    let mut depth = ln_1p((-logit.abs()).exp());
    if logit > 0.0f32 {
        depth += logit;
    }
    let depth = f * depth;
    // the smallest normal number
    (depth, one_less_exp(depth).max(1.175_494_4e-38f32))
}

/// The logit of the opacity of a splat that is present by `f`.
#[cube]
pub(super) fn faded(logit: f32, f: f32) -> f32 {
    let mut out = logit;
    if f < 1.0f32 {
        let (depth, opacity) = faint(logit, f);
        out = opacity.ln() + depth;
    }
    out
}

/// Its derivative with respect to the own logit.
#[cube]
pub(super) fn faded_slope(logit: f32, f: f32) -> f32 {
    let mut out = 1.0f32;
    if f < 1.0f32 {
        let (_, opacity) = faint(logit, f);
        out = f / (1.0f32 + (-logit).exp()) / opacity;
    }
    out
}

/// Logit of the opacity of a splat that is left out.
const NOWHERE: f32 = -60.0;

/// Carries the bound splats to the instant of the view, one unit a splat: mean, quaternion, logit
/// and constant colour into columns of `posed`. Those that are left out lie where the camera is,
/// which shows them nowhere.
#[cube(launch)]
pub(super) fn pose(
    geometry: &[f32],
    colour: &[f32],
    time: &[f32],
    eye: &[f32],
    table: &[u32],
    bindings: &[u32],
    motions: &[f32],
    posed: &mut [f32],
    n: u32,
    n_static: u32,
    n_bound: u32,
    #[comptime] isotropic: bool,
) {
    let j = ABSOLUTE_POS;
    if j < n_bound as usize {
        let (rows, dynamic, bound) = (n as usize, (n - n_static) as usize, n_bound as usize);
        let row = n_static as usize + j;
        let t = eye[TIME];
        let present = presence(bindings, table, j, bound, t);
        if present > 0.0f32 {
            let a = carrier(bindings, motions, j, bound);
            let dt = t - time[j];
            let (mean, velocity) = (
                v3_in(geometry, 0u32, rows, row),
                v3_in(time, 2u32, dynamic, j),
            );
            let (x, y, z) = (
                mean.x + velocity.x * dt,
                mean.y + velocity.y * dt,
                mean.z + velocity.z * dt,
            );
            posed[j] = a[4] * x + a[5] * y + a[6] * z + a[13];
            posed[bound + j] = a[7] * x + a[8] * y + a[9] * z + a[14];
            posed[2 * bound + j] = a[10] * x + a[11] * y + a[12] * z + a[15];
            if comptime!(!isotropic) {
                let own = quat(
                    in_column(geometry, 6u32, rows, row),
                    in_column(geometry, 7u32, rows, row),
                    in_column(geometry, 8u32, rows, row),
                    in_column(geometry, 9u32, rows, row),
                );
                let q = product(&quat(a[0], a[1], a[2], a[3]), &own);
                posed[3 * bound + j] = q.w;
                posed[4 * bound + j] = q.x;
                posed[5 * bound + j] = q.y;
                posed[6 * bound + j] = q.z;
            }
            let logit = in_column(
                geometry,
                comptime!(if isotropic { 4u32 } else { 10u32 }),
                rows,
                row,
            );
            posed[7 * bound + j] = faded(logit, present);
            #[unroll]
            for k in 0usize..3usize {
                posed[(8 + k) * bound + j] =
                    colour[k * rows + row] + time[(5 + k) * dynamic + j] * dt;
            }
        } else {
            posed[j] = eye[CENTRE];
            posed[bound + j] = eye[CENTRE + 1];
            posed[2 * bound + j] = eye[CENTRE + 2];
            posed[7 * bound + j] = f32::new(NOWHERE);
        }
    }
}
