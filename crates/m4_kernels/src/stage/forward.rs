//! From columns to the records of the bands.

use super::{Chunk, Group, Part};
use crate::{
    bin::{
        cpu::{BAND_TILES, Record},
        extent::Extent,
    },
    blend::ALPHA_MIN,
    project::cpu::{self as project, Eye},
    shade::cpu::{self as shade, Sight},
    simd::{FETCH_ROWS, LANES, all, bits, dot, each, lanes, load, log2, sigmoid, transpose},
    slice::cpu::{self as slice, Columns},
};
use fearless_simd::{Simd, f32x16, mask32x16, prelude::*, u32x16};
use fearless_simd_macros::simd;
use std::f32::consts::LOG2_E;

#[simd]
pub(super) fn chunk<S: Simd, const DYNAMIC: bool, const ISO: bool>(
    s: S,
    chunk: &mut Chunk,
    c: &Columns<'_>,
    eye: &Eye,
) {
    chunk.groups.clear();
    chunk.parts.clear();
    chunk.marginals.clear();
    for band in &mut chunk.bands {
        band.clear();
    }
    // the few columns of one colour a splat the processor fetches as well on its own
    let many = c.layout.colour_terms() > 1;
    let mut fetched = 0;
    for at in (0..chunk.rows.len()).step_by(LANES) {
        let row = chunk.rows.start + at;
        if !DYNAMIC || slice::any_alive(s, c, row, eye.t) {
            if many && at >= fetched {
                c.fetch::<DYNAMIC>(row);
                fetched = at + FETCH_ROWS;
            }
            group::<S, DYNAMIC, ISO>(s, chunk, c, eye, at);
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
    Sight {
        direction,
        inverse_distance,
        turns: dt * all(s, eye.inverse_period),
    }
}

#[inline(always)]
fn group<S: Simd, const DYNAMIC: bool, const ISO: bool>(
    s: S,
    chunk: &mut Chunk,
    c: &Columns<'_>,
    eye: &Eye,
    at: usize,
) {
    let row = chunk.rows.start + at;
    let rows = inside(chunk.rows.len() - at);
    let mut splat = slice::life::<S, DYNAMIC>(s, c, row, eye.t);
    let place = project::place(s, eye, &splat.mean);
    let near = splat.alive & place.point[2].simd_gt(all(s, eye.near));
    if bits(near) & rows == 0 {
        return;
    }
    slice::shape::<S, ISO>(s, c, row, &mut splat);
    let ellipse = project::ellipse::<S, ISO>(s, eye, &place, &splat);
    let logit = load(s, c.opacity, row, 0.0);
    let opacity = sigmoid(s, logit) * splat.marginal * ellipse.compensation;
    let strong = opacity.simd_ge(all(s, ALPHA_MIN as f32)) & project::finite(s, &ellipse, opacity);
    let log_opacity = log2(s, opacity);
    let extent = Extent::new(s, eye, &ellipse, log_opacity, near & strong);
    let candidates = bits(extent.on) & rows;
    if candidates == 0 {
        return;
    }
    let count = extent.rows(s, eye, &ellipse, candidates, &mut chunk.spans);
    let rgb = shade::shade(s, c, row, &sight(s, c, eye, &place.offset, splat.dt));
    let [a, b, d] = ellipse.conic;
    let (half, zero) = (all(s, 0.5 * LOG2_E), all(s, 0.0));
    let fields = transpose(&[
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
    let seen = emit(s, chunk, &extent, count, candidates, &fields);
    if seen != 0 {
        chunk.groups.push(Group {
            at: at as u32,
            seen,
            parts_end: chunk.parts.len() as u32,
        });
        if DYNAMIC {
            chunk.marginals.push(splat.marginal.to_array());
        }
    }
}

/// Hands the splats of a group to their bands; returns those that reach a tile.
#[inline(always)]
fn emit<S: Simd>(
    s: S,
    chunk: &mut Chunk,
    extent: &Extent<S>,
    count: usize,
    candidates: u16,
    fields: &[[f32; LANES]; LANES],
) -> u16 {
    let top = f32x16::from_slice(s, &extent.top);
    // first and last tile row in which a splat has a tile
    let (mut first, mut last) = (all(s, f32::MAX), all(s, -1.0));
    let none = u32x16::splat(s, 0);
    for (row, span) in chunk.spans[1..=count].iter().enumerate() {
        let hit = u32x16::from_slice(s, span).simd_gt(none);
        let here = top + all(s, row as f32);
        first = hit.select(first.min(here), first);
        last = hit.select(here, last);
    }
    let seen = bits(first.simd_le(last)) & candidates;
    if seen == 0 {
        return 0;
    }
    let on = mask32x16::from_bitmask(s, u64::from(seen));
    let lowest = on.select(first, all(s, f32::MAX)).reduce_min() as usize;
    let highest = on.select(last, all(s, 0.0)).reduce_max() as usize;
    let after = all(s, count as f32 + 1.0);
    for band in lowest / BAND_TILES..=highest / BAND_TILES {
        let row = (band * BAND_TILES) as f32;
        let here = first.simd_le(all(s, row + (BAND_TILES - 1) as f32)) & last.simd_ge(all(s, row));
        let here = bits(here) & seen;
        if here == 0 {
            continue;
        }
        chunk.parts.push(Part {
            band: band as u16,
            lanes: here,
        });
        // where in `spans` the rows of the band are; before and after those of the ellipse it holds 0
        let rows: [[u32; LANES]; BAND_TILES] = each!(BAND_TILES, k => {
            let at = all(s, row + k as f32 + 1.0) - top;
            at.max(all(s, 0.0)).min(after).to_int::<u32x16<S>>().to_array()
        });
        let (records, spans) = (&mut chunk.bands[band], &chunk.spans);
        for lane in lanes(here) {
            let f = &fields[lane];
            records.push(Record {
                x: f[0],
                y: f[1],
                a: f[2],
                b: f[3],
                c: f[4],
                log_opacity: f[5],
                rgb: [f[6], f[7], f[8]],
                depth: f[9],
                spans: each!(BAND_TILES, k => spans[rows[k][lane] as usize][lane]),
                unused: [0; 2],
            });
        }
    }
    seen
}
