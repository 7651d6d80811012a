//! Turns parameters into records.

use super::{RECORD, Spec, ellipse, offset_of, opacity_logit, row, sight};
use crate::gpu::eye::{INVERSE_PERIOD, NEAR, SIZE, TIME};
use crate::gpu::vector::dot;
use crate::shade::gpu::raw_colour;
use crate::slice::gpu::{life, shape};
use crate::tile_binning::gpu::reach::{REACH, Reach, tile_rows, tile_span};
use cubecl::prelude::*;
use std::f32::consts::{LN_2, LOG2_E};

const MARGINAL_MIN: f32 = crate::slice::MARGINAL_MIN as f32;
const ALPHA_MIN: f32 = crate::blend::ALPHA_MIN as f32;
const LOG2_ALPHA_MIN: f32 = crate::blend::LOG2_ALPHA_MIN as f32;
const HALF_LOG2_E: f32 = 0.5 * LOG2_E;
const TWO_LN_2: f32 = 2.0 * LN_2;

/// Fills the records of the splats in the frame, their depth keys (all ones for the others) and tile counts.
#[cube(launch)]
pub(crate) fn project(
    geometry: &[f32],
    colour: &[f32],
    time: &[f32],
    eye: &[f32],
    records: &mut [f32],
    reaches: &mut [f32],
    keys: &mut [u32],
    order: &mut [u32],
    counts: &mut [u32],
    n: u32,
    n_static: u32,
    #[comptime] spec: Spec,
) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        let at = i as usize;
        let rows = n as usize;
        let life = life(geometry, time, i, n, n_static, eye[TIME]);
        let offset = offset_of(eye, &life.mean);
        let z = dot(&row(eye, 2usize), &offset);
        let mut count = 0u32;
        let mut key = 0xffff_ffffu32;
        if life.marginal > MARGINAL_MIN && z > eye[NEAR] {
            let shape = shape(geometry, i, n, spec.isotropic);
            let e = ellipse(eye, &offset, &shape, spec.mip);
            let logit = opacity_logit(geometry, at, rows, spec.isotropic);
            let opacity = life.marginal * e.compensation / (1.0f32 + (-logit).exp());
            let inverse = 1.0f32 / e.det;
            // v * 0 is 0 for finite v, and NaN otherwise
            let sum = (e.u + e.v) * 0.0f32 + ((e.v00 + e.v11 - e.v01) * inverse + opacity) * 0.0f32;
            if opacity >= ALPHA_MIN && sum == 0.0f32 && e.det > 0.0f32 {
                let log_opacity = opacity.ln() * LOG2_E;
                let radius = (log_opacity - LOG2_ALPHA_MIN) * TWO_LN_2 + 0.002f32;
                let reach = Reach {
                    u: e.u,
                    v: e.v,
                    v00: e.v00,
                    v01: e.v01,
                    v11: e.v11,
                    radius: radius.max(0.0f32),
                    width: eye[SIZE],
                    height: eye[SIZE + 1],
                };
                let (first, end) = tile_rows(&reach);
                for row in first..end {
                    let (left, right) = tile_span(&reach, row);
                    count += right - left;
                }
                if count > 0u32 {
                    key = u32::reinterpret(z);
                    let (direction, _) = sight(&offset, spec.sh_terms);
                    let rgb = raw_colour(
                        colour,
                        at,
                        rows,
                        &direction,
                        life.dt * eye[INVERSE_PERIOD],
                        spec.sh_terms,
                        spec.time_terms,
                    );
                    let r = at * RECORD;
                    records[r] = e.u;
                    records[r + 1] = e.v;
                    records[r + 2] = e.v11 * inverse * HALF_LOG2_E;
                    records[r + 3] = -e.v01 * inverse * LOG2_E;
                    records[r + 4] = e.v00 * inverse * HALF_LOG2_E;
                    records[r + 5] = log_opacity;
                    records[r + 6] = rgb.x.max(0.0f32);
                    records[r + 7] = rgb.y.max(0.0f32);
                    records[r + 8] = rgb.z.max(0.0f32);
                    records[r + 9] = z;
                    let r = at * REACH;
                    reaches[r] = e.u;
                    reaches[r + 1] = e.v;
                    reaches[r + 2] = e.v00;
                    reaches[r + 3] = e.v01;
                    reaches[r + 4] = e.v11;
                    reaches[r + 5] = reach.radius;
                }
            }
        }
        keys[at] = key;
        order[at] = i;
        counts[at] = count;
    }
}
