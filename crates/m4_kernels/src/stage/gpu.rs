//! Splats to what tiles are made of, and back: slice, project, shade and the count of tiles in one
//! kernel, one unit per splat.

use crate::gpu::scan::scan_cube;
use crate::gpu::vector::{INVERSE_PERIOD, NEAR, SIZE, TIME, V3, dot, scaled};
use crate::project::gpu::{ellipse, offset_of, row};
use crate::shade::gpu::raw_colour;
use crate::slice::gpu::{Carried, carried, drawn_shape, life, posed_number};
use crate::splats::DeviceSplats;
use crate::tile_binning::gpu::{
    LARGE_SPLATS, MANY, REACH, RECORD, Reach, SLOTS, count_slack, tile_rows, tile_span,
};
pub(crate) use backward::{project_backward, sum_large};
use cubecl::prelude::*;
use std::f32::consts::{LN_2, LOG2_E};

mod backward;

/// What of a scene and a view is known when the kernel is compiled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct Spec {
    pub isotropic: bool,
    pub sh_terms: u32,
    pub time_terms: u32,
    pub mip: bool,
    /// Some splats are bound.
    pub bound: bool,
}

impl Spec {
    /// Of `splats`, with or without the Mip filter.
    pub(crate) fn new(splats: &DeviceSplats, mip: bool) -> Self {
        let layout = splats.layout;
        Self {
            isotropic: layout.isotropic,
            sh_terms: layout.sh_terms() as u32,
            time_terms: layout.time_degree as u32 + 1,
            mip,
            bound: splats.n_still() > splats.n_static,
        }
    }
}

#[cube]
pub(super) fn opacity_logit(
    geometry: &[f32],
    posed: &[f32],
    carried: &Carried,
    at: usize,
    rows: usize,
    #[comptime] spec: Spec,
) -> f32 {
    let k = comptime!(if spec.isotropic { 4usize } else { 10usize });
    let mut logit = geometry[k * rows + at];
    if comptime!(spec.bound) {
        if carried.on {
            logit = posed_number(posed, carried, 7usize);
        }
    }
    logit
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

const MARGINAL_MIN: f32 = crate::slice::MARGINAL_MIN as f32;
const ALPHA_MIN: f32 = crate::ellipse::ALPHA_MIN as f32;
const LOG2_ALPHA_MIN: f32 = crate::ellipse::LOG2_ALPHA_MIN as f32;
const HALF_LOG2_E: f32 = 0.5 * LOG2_E;
const TWO_LN_2: f32 = 2.0 * LN_2;

/// Fills the records of the splats in the frame, their depths and tile counts, notes where the
/// tiles' counts change, and gives every tile of a splat a slot: `offsets` is the first of them.
/// Which splats come first is different every time.
#[cube(launch)]
pub(crate) fn project(
    geometry: &[f32],
    colour: &[f32],
    time: &[f32],
    posed: &[f32],
    eye: &[f32],
    records: &mut [f32],
    reaches: &mut [f32],
    depths: &mut [u32],
    counts: &mut [u32],
    offsets: &mut [u32],
    changes: &[Atomic<u32>],
    allocated: &[Atomic<u32>],
    large: &mut [u32],
    n: u32,
    n_static: u32,
    n_still: u32,
    across: u32,
    #[comptime] spec: Spec,
) {
    let mut shared = Shared::<[u32]>::new_slice(256usize);
    let mut base = Shared::<[u32]>::new_slice(1usize);
    let i = ABSOLUTE_POS as u32;
    let mut count = 0u32;
    if i < n {
        let at = i as usize;
        let rows = n as usize;
        let carried = carried(i, n_static, n_still);
        let life = life(
            geometry, time, posed, &carried, i, n, n_static, n_still, eye[TIME], spec.bound,
        );
        let offset = offset_of(eye, &life.mean);
        let z = dot(&row(eye, 2usize), &offset);
        if life.marginal > MARGINAL_MIN && z > eye[NEAR] {
            let shape = drawn_shape(geometry, posed, &carried, i, n, spec.isotropic, spec.bound);
            let e = ellipse(eye, &offset, &shape, spec.mip);
            let logit = opacity_logit(geometry, posed, &carried, at, rows, spec);
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
                let slack = count_slack(&reach);
                let (first, end) = tile_rows(&reach, slack);
                for row in first..end {
                    let (left, right) = tile_span(&reach, row, slack);
                    if left < right {
                        // one more entry from the first tile on, one less after the last
                        changes[(row * across + left) as usize].fetch_add(1u32);
                        changes[(row * across + right) as usize].fetch_sub(1u32);
                        count += right - left;
                    }
                }
                if count > 0u32 {
                    depths[at] = u32::reinterpret(z);
                    let (direction, _) = sight(&offset, spec.sh_terms);
                    let rgb = raw_colour(
                        colour,
                        posed,
                        &carried,
                        at,
                        rows,
                        &direction,
                        life.dt * eye[INVERSE_PERIOD],
                        spec.sh_terms,
                        spec.time_terms,
                        spec.bound,
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
        counts[at] = count;
    }
    let before = scan_cube(count, &mut shared);
    if UNIT_POS == 255u32 {
        base[0] = allocated[SLOTS].fetch_add(before + count);
    }
    if count > MANY {
        large[allocated[LARGE_SPLATS].fetch_add(1u32) as usize] = i;
    }
    sync_cube();
    if i < n {
        offsets[i as usize] = base[0] + before;
    }
}
