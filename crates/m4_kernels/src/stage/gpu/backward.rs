//! Turns the sums of the tiles into gradients of the parameters.

use super::{Spec, opacity_logit, sight};
use crate::blend::gpu::backward::SUMS;
use crate::gpu::log::write_parts;
use crate::gpu::vector::{FOCAL, INVERSE_PERIOD, TIME};
use crate::gpu::vector::{add_scaled, dot, scaled, times, transposed, v3};
use crate::project::gpu::{LOW_PASS, ellipse, offset_of, row};
use crate::shade::gpu::shade_backward;
use crate::slice::gpu::{carried, drawn_shape, life, quat_backward};
use crate::tile_binning::gpu::{LARGE, MANY};
use cubecl::prelude::*;

/// The smallest normal number.
const SMALLEST: f32 = f32::MIN_POSITIVE;

/// Adds up each splat's sums in the order of its slots and turns them into gradients of its
/// parameters; rows of splats that are not in the frame keep what they hold, `touched` says which
/// are. Of bound splats it is the gradient of what is drawn. Into `camera` the sums of each cube of
/// 256 splats for the camera's own gradient, and into `centres` the gradients of the projected
/// centres, `[2][n]`, where they are wanted.
#[cube(launch)]
pub(crate) fn project_backward(
    geometry: &[f32],
    colour: &[f32],
    time: &[f32],
    posed: &[f32],
    eye: &[f32],
    counts: &[u32],
    offsets: &[u32],
    sums: &[f32],
    d_geometry: &mut [f32],
    d_colour: &mut [f32],
    d_time: &mut [f32],
    touched: &mut [u32],
    camera: &mut [f32],
    centres: &mut [f32],
    n: u32,
    n_static: u32,
    n_still: u32,
    #[comptime] spec: Spec,
    #[comptime] with_camera: bool,
    #[comptime] with_centres: bool,
) {
    let mut share = Array::<f32>::new(10usize);
    if comptime!(with_camera) {
        #[unroll]
        for k in 0usize..10usize {
            share[k] = f32::new(0.0f32);
        }
    }
    let i = ABSOLUTE_POS as u32;
    let mut count = 0u32;
    if i < n {
        count = counts[i as usize];
    }
    if i < n {
        let at = i as usize;
        let rows = n as usize;
        let mut touch_flag = 0u32;
        if count > 0u32 {
            let sum = sum_of_slots(offsets[at], count, sums);
            let (weight, mx, my) = (sum[0], sum[1], sum[2]);
            let (xx, xy, yy) = (sum[3], sum[4], sum[5]);
            let (d_red, d_green, d_blue) = (sum[6], sum[7], sum[8]);
            let size = weight.abs() + d_red.abs() + d_green.abs() + d_blue.abs();
            if size > 0.0f32 {
                touch_flag = 1u32;
            }
            let carried = carried(i, n_static, n_still);
            let life = life(
                geometry, time, posed, &carried, i, n, n_static, n_still, eye[TIME], spec.bound,
            );
            let offset = offset_of(eye, &life.mean);
            let shape = drawn_shape(geometry, posed, &carried, i, n, spec.isotropic, spec.bound);
            let e = ellipse(eye, &offset, &shape, spec.mip);
            let inverse = 1.0f32 / e.det;
            let (a, b, c) = (e.v11 * inverse, -e.v01 * inverse, e.v00 * inverse);
            let cu = -(a * mx + b * my);
            let cv = -(b * mx + c * my);
            if comptime!(with_centres) {
                centres[at] = cu;
                centres[rows + at] = cv;
            }
            // conic times moments times conic, halved
            let (p00, p01) = (a * xx + b * xy, a * xy + b * yy);
            let (p10, p11) = (b * xx + c * xy, b * xy + c * yy);
            let mut g00 = 0.5f32 * (p00 * a + p01 * b);
            let mut g01 = 0.5f32 * (p00 * b + p01 * c);
            let mut g11 = 0.5f32 * (p10 * b + p11 * c);
            if comptime!(spec.mip) {
                if e.sharp_det > SMALLEST {
                    let i = 1.0f32 / e.sharp_det;
                    let w = 0.5f32 * weight;
                    g00 += w * ((e.v11 - LOW_PASS) * i - a);
                    g01 += w * (-e.v01 * i - b);
                    g11 += w * ((e.v00 - LOW_PASS) * i - c);
                }
            }
            let df = add_scaled(&scaled(&e.f, 2.0f32 * g00), 2.0f32 * g01, &e.g);
            let dg = add_scaled(&scaled(&e.f, 2.0f32 * g01), 2.0f32 * g11, &e.g);
            let log_scale = add_scaled(&times(&df, &e.f), 1.0f32, &times(&dg, &e.g));
            let (sf, sg) = (times(&df, &shape.scale), times(&dg, &shape.scale));
            let da = v3(
                dot(&sf, &shape.r0),
                dot(&sf, &shape.r1),
                dot(&sf, &shape.r2),
            );
            let db = v3(
                dot(&sg, &shape.r0),
                dot(&sg, &shape.r1),
                dot(&sg, &shape.r2),
            );
            let (w0, w1, w2) = (row(eye, 0usize), row(eye, 1usize), row(eye, 2usize));
            let iz = 1.0f32 / e.point.z;
            let (jx, jy) = (eye[FOCAL] * iz, eye[FOCAL + 1] * iz);
            let mut dx = cu * jx;
            let mut dy = cv * jy;
            let mut dz = -(cu * jx * e.ray_x + cv * jy * e.ray_y)
                - (dot(&da, &w0) * jx + dot(&db, &w1) * jy) * iz;
            let d = dot(&da, &w2) * jx * iz;
            if e.slope_x == e.ray_x {
                dx -= d;
                dz += 2.0f32 * d * e.slope_x;
            } else {
                dz += d * e.slope_x;
            }
            let d = dot(&db, &w2) * jy * iz;
            if e.slope_y == e.ray_y {
                dy -= d;
                dz += 2.0f32 * d * e.slope_y;
            } else {
                dz += d * e.slope_y;
            }
            let (direction, inverse_distance) = sight(&offset, spec.sh_terms);
            let seen_from = shade_backward(
                colour,
                posed,
                &carried,
                at,
                rows,
                &direction,
                inverse_distance,
                life.dt * eye[INVERSE_PERIOD],
                eye[INVERSE_PERIOD],
                &v3(d_red, d_green, d_blue),
                d_colour,
                spec.sh_terms,
                spec.time_terms,
                spec.bound,
            );
            if comptime!(with_camera) {
                let (jz0, jz1) = (-(jx * e.slope_x), -(jy * e.slope_y));
                let d0 = v3(dot(&da, &w0), dot(&da, &w1), dot(&da, &w2));
                let d1 = v3(dot(&db, &w0), dot(&db, &w1), dot(&db, &w2));
                let (x, y, z) = (e.point.x, e.point.y, e.point.z);
                share[0] = dx + dot(&w0, &seen_from.offset);
                share[1] = dy + dot(&w1, &seen_from.offset);
                share[2] = dz + dot(&w2, &seen_from.offset);
                share[3] = y * dz - z * dy + jz0 * d0.y + jz1 * d1.y - jy * d1.z;
                share[4] = z * dx - x * dz + jx * d0.z - jz0 * d0.x - jz1 * d1.x;
                share[5] = x * dy - y * dx + jy * d1.x - jx * d0.y;
                share[6] = cu * e.ray_x + (d0.x - d0.z * e.slope_x) * iz;
                share[7] = cv * e.ray_y + (d1.y - d1.z * e.slope_y) * iz;
                share[8] = cu;
                share[9] = cv;
            }
            let mean = add_scaled(
                &transposed(&w0, &w1, &w2, &v3(dx, dy, dz)),
                1.0f32,
                &seen_from.offset,
            );
            d_geometry[at] = mean.x;
            d_geometry[rows + at] = mean.y;
            d_geometry[2 * rows + at] = mean.z;
            let logit = opacity_logit(geometry, posed, &carried, at, rows, spec);
            let d_logit = weight * (1.0f32 - 1.0f32 / (1.0f32 + (-logit).exp()));
            if comptime!(spec.isotropic) {
                d_geometry[3 * rows + at] = log_scale.x + log_scale.y + log_scale.z;
                d_geometry[4 * rows + at] = d_logit;
            } else {
                d_geometry[3 * rows + at] = log_scale.x;
                d_geometry[4 * rows + at] = log_scale.y;
                d_geometry[5 * rows + at] = log_scale.z;
                d_geometry[10 * rows + at] = d_logit;
                let g0 = add_scaled(&scaled(&sf, e.a.x), e.b.x, &sg);
                let g1 = add_scaled(&scaled(&sf, e.a.y), e.b.y, &sg);
                let g2 = add_scaled(&scaled(&sf, e.a.z), e.b.z, &sg);
                quat_backward(&shape, &g0, &g1, &g2, d_geometry, at, rows);
            }
            if i >= n_still {
                let j = (i - n_static) as usize;
                let dynamic = (n - n_static) as usize;
                let velocity = v3(
                    time[2 * dynamic + j],
                    time[3 * dynamic + j],
                    time[4 * dynamic + j],
                );
                d_time[j] = seen_from.time_mean + weight * life.dt * life.inverse_variance
                    - dot(&mean, &velocity);
                d_time[dynamic + j] = weight * life.dt * life.dt * life.inverse_variance;
                d_time[2 * dynamic + j] = mean.x * life.dt;
                d_time[3 * dynamic + j] = mean.y * life.dt;
                d_time[4 * dynamic + j] = mean.z * life.dt;
            }
        }
        touched[at] = touch_flag;
    }
    if comptime!(with_camera) {
        write_parts(&share, camera, 10usize);
    }
}

/// Units that add up a part each of one of the nine sums: 28 parts.
const ADDERS: u32 = 252;

/// The sums of a splat over its slots in their order; those of a large one are in its first slot.
#[cube]
fn sum_of_slots(first: u32, count: u32, sums: &[f32]) -> Array<f32> {
    let mut out = Array::<f32>::new(SUMS);
    #[unroll]
    for k in 0usize..SUMS {
        out[k] = f32::new(0.0f32);
    }
    let mut end = first + count;
    if count > MANY {
        end = first + 1u32;
    }
    for slot in first..end {
        #[unroll]
        for k in 0usize..SUMS {
            out[k] += sums[slot as usize * SUMS + k];
        }
    }
    out
}

/// Adds up the slots of each large splat, in an order that is the same every time, and leaves the
/// sums in its first slot. A cube takes one after the other.
#[cube(launch)]
pub(crate) fn sum_large(
    counts: &[u32],
    offsets: &[u32],
    large: &[u32],
    totals: &[u32],
    sums: &mut [f32],
) {
    let mut shares = Shared::<[f32]>::new_slice(256usize * SUMS);
    let mut parts = Shared::<[f32]>::new_slice(252usize);
    let number = totals[LARGE];
    let mut next = CUBE_POS as u32;
    while next < number {
        let splat = large[next as usize] as usize;
        let first = offsets[splat];
        let count = counts[splat];
        // fewer can have been made than were counted
        if count > MANY {
            let mut share = Array::<f32>::new(SUMS);
            #[unroll]
            for k in 0usize..SUMS {
                share[k] = f32::new(0.0f32);
            }
            let mut slot = first + UNIT_POS;
            while slot < first + count {
                #[unroll]
                for k in 0usize..SUMS {
                    share[k] += sums[slot as usize * SUMS + k];
                }
                slot += 256u32;
            }
            #[unroll]
            for k in 0usize..SUMS {
                shares[256 * k + UNIT_POS as usize] = share[k];
            }
            sync_cube();
            if UNIT_POS < ADDERS {
                let from = (UNIT_POS / 28u32) as usize * 256;
                let start = (UNIT_POS % 28u32) * 10u32;
                let mut part = 0.0f32;
                for k in start.min(256u32)..(start + 10u32).min(256u32) {
                    part += shares[from + k as usize];
                }
                parts[UNIT_POS as usize] = part;
            }
            sync_cube();
            if UNIT_POS < 9u32 {
                let mut total = 0.0f32;
                for part in 0u32..28u32 {
                    total += parts[(28u32 * UNIT_POS + part) as usize];
                }
                sums[first as usize * SUMS + UNIT_POS as usize] = total;
            }
        }
        next += CUBE_COUNT as u32;
    }
}
