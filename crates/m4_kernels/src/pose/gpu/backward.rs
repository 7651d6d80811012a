//! Gradients of what is drawn of bound splats, back to the splats and to the nodes that carry them.

use super::forward::{
    Quat, carrier, conjugate, faded_slope, in_column, of_window, presence, product, quat, quat_at,
    side, v3_at, v3_in,
};
use super::moment::{ADD, FIRST, KEY, NODES};
use crate::gpu::buffer::NOTHING;
use crate::gpu::vector::{TIME, cross, dot, v3};
use crate::splats::{MOTION, NODE, WEIGHT};
use cubecl::prelude::*;

/// Units that add up the splats of a node.
pub(super) const UNITS: usize = 64;
/// Where their sums are first halved.
const _: () = assert!(UNITS == 2 * 32);

#[cube]
fn rotation_in(geometry: &[f32], rows: usize, row: usize) -> Quat {
    quat(
        in_column(geometry, 6u32, rows, row),
        in_column(geometry, 7u32, rows, row),
        in_column(geometry, 8u32, rows, row),
        in_column(geometry, 9u32, rows, row),
    )
}

/// The gradients of the nodes at the keys at this instant, a cube a node: sums over the splats that
/// it carries, in an order that is the same every time.
#[cube(launch)]
pub(super) fn node_sums(
    geometry: &[f32],
    time: &[f32],
    d_geometry: &[f32],
    touched: &[u32],
    eye: &[f32],
    table: &[u32],
    bindings: &[u32],
    motions: &[f32],
    anchors: &[f32],
    starts: &[u32],
    entries: &[u32],
    sums: &mut [f32],
    n: u32,
    n_static: u32,
    n_bound: u32,
    list: u32,
    active: u32,
    most: u32,
    #[comptime] isotropic: bool,
) {
    let mut shared = Shared::<[f32]>::new_slice(6 * UNITS);
    let cube = CUBE_POS as u32;
    if cube < active * most {
        let window = table[(list + cube / most) as usize] as usize;
        let place = cube % most;
        let key = of_window(table, window, KEY);
        if key != NOTHING && place < of_window(table, window, NODES) {
            let (rows, dynamic, bound) = (n as usize, (n - n_static) as usize, n_bound as usize);
            let node = (of_window(table, window, FIRST) + place) as usize;
            let anchor = v3_at(anchors, 3 * node);
            let (r0, r1, r2) = (
                v3_at(motions, node * MOTION + 4),
                v3_at(motions, node * MOTION + 7),
                v3_at(motions, node * MOTION + 10),
            );
            let back = conjugate(&quat_at(motions, node * MOTION));
            let t = eye[TIME];
            let mut share = Array::<f32>::new(6usize);
            #[unroll]
            for k in 0usize..6usize {
                share[k] = f32::new(0.0f32);
            }
            let mut entry = starts[node] + UNIT_POS;
            while entry < starts[node + 1] {
                let code = entries[entry as usize];
                let j = (code / 4u32) as usize;
                let row = n_static as usize + j;
                let mut is_touched = touched[row] != 0u32;
                if is_touched {
                    is_touched = presence(bindings, table, j, bound, t) > 0.0f32;
                }
                if is_touched {
                    let weight =
                        f32::reinterpret(bindings[(WEIGHT + (code % 4u32) as usize) * bound + j]);
                    let g = v3_in(d_geometry, 0u32, rows, row);
                    let dt = t - time[j];
                    let (mean, velocity) = (
                        v3_in(geometry, 0u32, rows, row),
                        v3_in(time, 2u32, dynamic, j),
                    );
                    let from = v3(
                        mean.x + velocity.x * dt - anchor.x,
                        mean.y + velocity.y * dt - anchor.y,
                        mean.z + velocity.z * dt - anchor.z,
                    );
                    let arm = v3(dot(&r0, &from), dot(&r1, &from), dot(&r2, &from));
                    let moment = cross(&arm, &g);
                    share[0] += weight * g.x;
                    share[1] += weight * g.y;
                    share[2] += weight * g.z;
                    let mut x = moment.x;
                    let mut y = moment.y;
                    let mut z = moment.z;
                    if comptime!(!isotropic) {
                        let first = bindings[NODE * bound + j] as usize;
                        let half = 0.5f32 * side(motions, first, node);
                        let own = rotation_in(geometry, rows, row);
                        let turn = product(
                            &product(&rotation_in(d_geometry, rows, row), &conjugate(&own)),
                            &back,
                        );
                        x += half * turn.x;
                        y += half * turn.y;
                        z += half * turn.z;
                    }
                    share[3] += weight * x;
                    share[4] += weight * y;
                    share[5] += weight * z;
                }
                entry += UNITS as u32;
            }
            #[unroll]
            for k in 0usize..6usize {
                shared[k * UNITS + UNIT_POS as usize] = share[k];
            }
            sync_cube();
            let mut half = 32u32;
            while half > 0u32 {
                if UNIT_POS < half {
                    #[unroll]
                    for k in 0usize..6usize {
                        let at = k * UNITS + UNIT_POS as usize;
                        shared[at] += shared[at + half as usize];
                    }
                }
                sync_cube();
                half /= 2u32;
            }
            if UNIT_POS < 6u32 {
                let to = ((key + place) * 6u32 + UNIT_POS) as usize;
                let mut sum = shared[UNIT_POS as usize * UNITS];
                if of_window(table, window, ADD) != 0u32 {
                    sum += sums[to];
                }
                sums[to] = sum;
            }
        }
    }
}

/// Turns the gradients with respect to what is drawn of bound splats into those with respect to
/// their parameters, one unit a splat.
#[cube(launch)]
pub(super) fn own_gradients(
    geometry: &[f32],
    time: &[f32],
    d_geometry: &mut [f32],
    d_colour: &[f32],
    d_time: &mut [f32],
    touched: &[u32],
    eye: &[f32],
    table: &[u32],
    bindings: &[u32],
    motions: &[f32],
    n: u32,
    n_static: u32,
    n_bound: u32,
    #[comptime] isotropic: bool,
) {
    let j = ABSOLUTE_POS;
    if j < n_bound as usize {
        let (rows, dynamic, bound) = (n as usize, (n - n_static) as usize, n_bound as usize);
        let row = n_static as usize + j;
        if touched[row] != 0u32 {
            let t = eye[TIME];
            let present = presence(bindings, table, j, bound, t);
            let a = carrier(bindings, motions, j, bound);
            let dt = t - time[j];
            let (gx, gy, gz) = (
                d_geometry[row],
                d_geometry[rows + row],
                d_geometry[2 * rows + row],
            );
            #[unroll]
            for k in 0usize..3usize {
                let own = a[4 + k] * gx + a[7 + k] * gy + a[10 + k] * gz;
                d_geometry[k * rows + row] = own;
                d_time[(2 + k) * dynamic + j] = own * dt;
                d_time[(5 + k) * dynamic + j] = d_colour[k * rows + row] * dt;
            }
            if comptime!(!isotropic) {
                let g = quat(
                    d_geometry[6 * rows + row],
                    d_geometry[7 * rows + row],
                    d_geometry[8 * rows + row],
                    d_geometry[9 * rows + row],
                );
                let own = product(&conjugate(&quat(a[0], a[1], a[2], a[3])), &g);
                d_geometry[6 * rows + row] = own.w;
                d_geometry[7 * rows + row] = own.x;
                d_geometry[8 * rows + row] = own.y;
                d_geometry[9 * rows + row] = own.z;
            }
            let column = comptime!(if isotropic { 4usize } else { 10usize });
            let logit = geometry[column * rows + row];
            d_geometry[column * rows + row] *= faded_slope(logit, present);
            d_time[j] = f32::new(0.0f32);
            d_time[dynamic + j] = f32::new(0.0f32);
        }
    }
}
