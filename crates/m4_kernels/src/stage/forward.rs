//! Turns columns into the records of the bands.

use super::{Chunk, Group, Part};
use crate::{
    blend::ALPHA_MIN,
    project::cpu::{self as project, Ellipse, Eye},
    shade::cpu::{self as shade, Sight},
    simd::{FETCH_ROWS, LANES, all, dot, each, load, log2, sigmoid, turn},
    slice::cpu::{self as slice, Columns},
    tile_binning::{
        extent::Extent,
        handover::{FIELDS, Row},
    },
};
use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};
use fearless_simd_macros::simd;
use std::f32::consts::LOG2_E;

#[simd]
pub(super) fn chunk<S: Simd, const DYNAMIC: bool, const ISO: bool>(
    s: S,
    chunk: &mut Chunk,
    c: &Columns<'_>,
    eye: &Eye,
    out: &mut [Row],
) {
    chunk.groups.clear();
    chunk.parts.clear();
    chunk.marginals.clear();
    for band in &mut chunk.bands {
        band.clear();
    }
    // the few columns of one colour per splat the processor fetches as well on its own
    let many = c.layout.colour_terms() > 1;
    let mut fetched = 0;
    for at in (0..chunk.rows.len()).step_by(LANES) {
        let row = chunk.rows.start + at;
        if !DYNAMIC || slice::any_alive(s, c, row, eye.t) {
            if many && at >= fetched {
                c.fetch::<DYNAMIC>(row);
                fetched = at + FETCH_ROWS;
            }
            group::<S, DYNAMIC, ISO>(s, chunk, c, eye, at, out);
        }
    }
}

/// The lanes of a group that are rows of the chunk.
#[inline(always)]
fn inside(left: usize) -> u16 {
    if left >= LANES { u16::MAX } else { (1 << left) - 1 }
}

/// One over the length of a vector from the camera, and the unit vector.
#[inline(always)]
pub(super) fn sight<S: Simd>(s: S, c: &Columns<'_>, eye: &Eye, offset: &[f32x16<S>; 3], dt: f32x16<S>) -> Sight<S> {
    let (mut direction, mut inverse_distance) = (*offset, all(s, 0.0));
    if c.layout.sh_degree > 0 {
        inverse_distance = all(s, 1.0) / dot(offset, offset).sqrt();
        direction = each!(3, k => offset[k] * inverse_distance);
    }
    Sight { direction, inverse_distance, turns: dt * all(s, eye.inverse_period) }
}

#[inline(always)]
fn group<S: Simd, const DYNAMIC: bool, const ISO: bool>(
    s: S,
    chunk: &mut Chunk,
    c: &Columns<'_>,
    eye: &Eye,
    at: usize,
    out: &mut [Row],
) {
    let row = chunk.rows.start + at;
    let rows = inside(chunk.rows.len() - at);
    let mut splat = slice::life::<S, DYNAMIC>(s, c, row, eye.t);
    let place = project::place(s, eye, &splat.mean);
    let inside = mask32x16::from_bitmask(s, u64::from(rows));
    let near = inside & splat.alive & place.point[2].simd_gt(all(s, eye.near));
    if !near.any_true() {
        return;
    }
    slice::shape::<S, ISO>(s, c, row, &mut splat);
    let ellipse = project::ellipse::<S, ISO>(s, eye, &place, &splat);
    let logit = load(s, c.opacity, row, 0.0);
    let opacity = sigmoid(s, logit) * splat.marginal * ellipse.compensation;
    let strong = opacity.simd_ge(all(s, ALPHA_MIN as f32)) & project::finite(s, &ellipse, opacity);
    let log_opacity = log2(s, opacity);
    let extent = Extent::new(s, eye, &ellipse, log_opacity, near & strong);
    if !extent.on.any_true() {
        return;
    }
    let seen = emit(s, chunk, at, eye, &ellipse, &extent);
    if seen == 0 {
        return;
    }
    let rgb = shade::shade(s, c, row, &sight(s, c, eye, &place.offset, splat.dt));
    let [a, b, d] = ellipse.conic;
    let (half, zero) = (all(s, 0.5 * LOG2_E), all(s, 0.0));
    let rows = turn(&[
        ellipse.u,
        ellipse.v,
        half * a,
        all(s, LOG2_E) * b,
        half * d,
        log_opacity,
        rgb[0],
        rgb[1],
        rgb[2],
        place.point[2],
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
    ]);
    let out = out[at..at + LANES].as_flattened_mut();
    // a row is shorter than a vector: what is written behind it the next row overwrites
    for lane in 0..LANES - 1 {
        rows[lane].store_slice(&mut out[lane * FIELDS..lane * FIELDS + LANES]);
    }
    let last: [f32; LANES] = rows[LANES - 1].to_array();
    out[(LANES - 1) * FIELDS..].copy_from_slice(&last[..FIELDS]);
    chunk.groups.push(Group { at: at as u32, seen, parts_end: chunk.parts.len() as u32 });
    if DYNAMIC {
        chunk.marginals.push(splat.marginal.to_array());
    }
}

/// Hands the splats of a group to their bands; returns those that reach a tile.
#[inline(always)]
fn emit<S: Simd>(s: S, chunk: &mut Chunk, at: usize, eye: &Eye, ellipse: &Ellipse<S>, extent: &Extent<S>) -> u16 {
    let row = (chunk.place + at) as u32;
    let mut seen = 0;
    for band in extent.bands() {
        // neighbours are mostly in neighbouring bands, but need not be
        if !extent.may_reach(s, band) {
            continue;
        }
        let reach = extent.reach(s, eye, ellipse, band);
        let lanes = reach.lanes(s);
        if lanes != 0 {
            chunk.bands[band].push(s, row, lanes, &reach);
            chunk.parts.push(Part { band: band as u16, lanes });
            seen |= lanes;
        }
    }
    seen
}
