//! Slice, project and shade in one pass over the columns, and the same way back.
//!
//! Rows are cut into fixed chunks, static and dynamic rows apart; a chunk is a task. Forward, it hands
//! one [`Record`] to every band that a splat reaches. Backward, it collects the moments of its splats
//! from the bands, in the order of the bands, and turns them into gradients of the columns.

use crate::{
    bin::{
        cpu::{BAND_TILES, Record},
        extent::Extent,
    },
    blend::{ALPHA_MIN, cpu::Sums},
    project::cpu::{self as project, Eye, Moments},
    shade::cpu::{self as shade, Sight},
    simd::{LANES, all, all3, bits, dot, each, lanes, load, log2, sigmoid, store},
    slice::cpu::{self as slice, Columns, Slice, SliceGradient},
};
use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};
use fearless_simd_macros::simd;
use m4_scene::Column;
use std::{f32::consts::LOG2_E, ops::Range};

/// Rows a chunk: enough to make the task worth it, few enough to share the work evenly.
const CHUNK_ROWS: usize = 2048;

/// Sixteen rows of which at least one is seen.
#[derive(Debug, Clone, Copy)]
struct Group {
    /// From the first row of the chunk.
    at: u32,
    seen: u16,
}

/// What a splat that is seen left behind.
#[derive(Debug, Clone, Copy)]
struct Seen {
    first_band: u16,
    last_band: u16,
    marginal: f32,
}

/// One chunk of rows and what it showed in the last frame.
#[derive(Debug, Default)]
pub(crate) struct Chunk {
    pub(crate) rows: Range<usize>,
    pub(crate) dynamic: bool,
    /// Records for each band, in the order of the rows.
    pub(crate) bands: Vec<Vec<Record>>,
    groups: Vec<Group>,
    seen: Vec<Seen>,
    spans: Vec<[u32; LANES]>,
}

impl Chunk {
    /// Cuts rows into chunks, keeping the memory of those that were there.
    pub(crate) fn plan(chunks: &mut Vec<Self>, n_static: usize, n_dynamic: usize, bands: usize) {
        let cut = |rows: Range<usize>, dynamic: bool| {
            rows.clone()
                .step_by(CHUNK_ROWS)
                .map(move |start| (start..rows.end.min(start + CHUNK_ROWS), dynamic))
        };
        let plan: Vec<_> = cut(0..n_static, false)
            .chain(cut(n_static..n_static + n_dynamic, true))
            .collect();
        chunks.resize_with(plan.len(), Self::default);
        for (chunk, (rows, dynamic)) in chunks.iter_mut().zip(plan) {
            chunk.rows = rows;
            chunk.dynamic = dynamic;
            chunk.bands.resize_with(bands, Vec::new);
        }
    }

    /// Splats that reach the image.
    pub(crate) fn visible(&self) -> usize {
        self.seen.len()
    }

    /// Fills `bands`.
    #[inline(always)]
    pub(crate) fn forward<S: Simd>(&mut self, s: S, c: &Columns<'_>, eye: &Eye) {
        match (self.dynamic, c.layout.isotropic) {
            (false, false) => forward::<S, false, false>(s, self, c, eye),
            (false, true) => forward::<S, false, true>(s, self, c, eye),
            (true, false) => forward::<S, true, false>(s, self, c, eye),
            (true, true) => forward::<S, true, true>(s, self, c, eye),
        }
    }

    /// Fills the chunk's part of the gradients; `sums[band]` starts at this chunk's first record.
    #[inline(always)]
    pub(crate) fn backward<S: Simd>(
        &self,
        s: S,
        c: &Columns<'_>,
        eye: &Eye,
        sums: &mut [&[Sums]],
        out: &mut ChunkGradient<'_>,
    ) -> CameraSums {
        match (self.dynamic, c.layout.isotropic) {
            (false, false) => backward::<S, false, false>(s, self, c, eye, sums, out),
            (false, true) => backward::<S, false, true>(s, self, c, eye, sums, out),
            (true, false) => backward::<S, true, false>(s, self, c, eye, sums, out),
            (true, true) => backward::<S, true, true>(s, self, c, eye, sums, out),
        }
    }

    /// Adds marginal times score to the chunk's rows; `scores[band]` starts at its first record.
    pub(crate) fn score(&self, scores: &mut [&[f32]], out: &mut [f32]) {
        let mut seen = self.seen.iter();
        for group in &self.groups {
            for lane in lanes(group.seen) {
                let Some(splat) = seen.next() else { return };
                let mut sum = 0.0;
                for band in &mut scores[splat.first_band as usize..=splat.last_band as usize] {
                    let (first, rest) = band.split_at(1);
                    sum += first[0];
                    *band = rest;
                }
                out[group.at as usize + lane] += splat.marginal * sum;
            }
        }
    }
}

/// One chunk's rows of [`crate::Gradients`].
#[derive(Debug)]
pub(crate) struct ChunkGradient<'a> {
    pub(crate) columns: Vec<&'a mut [f32]>,
    pub(crate) touched: &'a mut [u8],
    pub(crate) means2d: &'a mut [[f32; 2]],
}

/// One chunk's share of the camera's gradient: `tau`, `omega`, `fx, fy, cx, cy`.
pub(crate) type CameraSums = [f64; 10];

/// The lanes of a group that are rows of the chunk.
#[inline(always)]
fn inside(left: usize) -> u16 {
    if left >= LANES { u16::MAX } else { (1 << left) - 1 }
}

#[simd]
fn forward<S: Simd, const DYNAMIC: bool, const ISO: bool>(s: S, chunk: &mut Chunk, c: &Columns<'_>, eye: &Eye) {
    chunk.groups.clear();
    chunk.seen.clear();
    for band in &mut chunk.bands {
        band.clear();
    }
    let mut at = 0;
    while at < chunk.rows.len() {
        group_forward::<S, DYNAMIC, ISO>(s, chunk, c, eye, at);
        at += LANES;
    }
}

/// One over the length of a vector from the camera, and the unit vector.
#[inline(always)]
fn sight<S: Simd>(s: S, c: &Columns<'_>, eye: &Eye, offset: &[f32x16<S>; 3], dt: f32x16<S>) -> Sight<S> {
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
fn group_forward<S: Simd, const DYNAMIC: bool, const ISO: bool>(
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
    let logit = load(s, c.get(Column::Opacity, 0), row, 0.0);
    let opacity = sigmoid(s, logit) * splat.marginal * ellipse.compensation;
    let strong = opacity.simd_ge(all(s, ALPHA_MIN as f32)) & project::finite(s, &ellipse, opacity);
    let mut extent = Extent::new(s, eye, &ellipse, opacity, near & strong);
    let candidates = bits(extent.on) & rows;
    if candidates == 0 {
        return;
    }
    extent.rows(s, eye, &ellipse, candidates, &mut chunk.spans);
    let rgb = shade::shade(s, c, row, &sight(s, c, eye, &place.offset, splat.dt));
    let [a, b, d] = ellipse.conic;
    let half = all(s, 0.5 * LOG2_E);
    let vectors = [
        ellipse.u,
        ellipse.v,
        half * a,
        all(s, LOG2_E) * b,
        half * d,
        log2(s, opacity),
        rgb[0],
        rgb[1],
        rgb[2],
        place.point[2],
        splat.marginal,
    ];
    let fields = each!(11, i => vectors[i].to_array());
    let mut seen = 0u16;
    for lane in lanes(candidates) {
        if emit(chunk, &extent, &fields, lane) {
            seen |= 1 << lane;
        }
    }
    if seen != 0 {
        chunk.groups.push(Group { at: at as u32, seen });
    }
}

/// Hands one splat to its bands; false if it reaches no tile.
#[inline(always)]
fn emit<S: Simd>(chunk: &mut Chunk, extent: &Extent<S>, fields: &[[f32; LANES]; 11], lane: usize) -> bool {
    let (top, bottom) = (extent.top[lane] as usize, extent.bottom[lane] as usize);
    let spans = &chunk.spans;
    let span = |ty: usize| {
        if ty < top || ty > bottom {
            0
        } else {
            spans[ty - top][lane]
        }
    };
    let Some(first) = (top..=bottom).find(|&ty| span(ty) != 0) else {
        return false;
    };
    let last = (first..=bottom).rev().find(|&ty| span(ty) != 0).unwrap_or(first);
    let get = |field: usize| fields[field][lane];
    let mut record = Record {
        x: get(0),
        y: get(1),
        a: get(2),
        b: get(3),
        c: get(4),
        log_opacity: get(5),
        rgb: [get(6), get(7), get(8)],
        depth: get(9),
        spans: [0; BAND_TILES],
        unused: [0; 2],
    };
    let (first_band, last_band) = (first / BAND_TILES, last / BAND_TILES);
    for band in first_band..=last_band {
        record.spans = std::array::from_fn(|k| span(band * BAND_TILES + k));
        chunk.bands[band].push(record);
    }
    chunk.seen.push(Seen {
        first_band: first_band as u16,
        last_band: last_band as u16,
        marginal: get(10),
    });
    true
}

#[simd]
fn backward<S: Simd, const DYNAMIC: bool, const ISO: bool>(
    s: S,
    chunk: &Chunk,
    c: &Columns<'_>,
    eye: &Eye,
    sums: &mut [&[Sums]],
    out: &mut ChunkGradient<'_>,
) -> CameraSums {
    let mut camera = [all(s, 0.0); 10];
    let mut seen = chunk.seen.iter();
    for group in &chunk.groups {
        let mut moments = [[0.0f32; LANES]; Sums::LEN];
        for lane in lanes(group.seen) {
            let Some(splat) = seen.next() else { break };
            let mut total = [0.0f32; Sums::LEN];
            for band in &mut sums[splat.first_band as usize..=splat.last_band as usize] {
                let (first, rest) = band.split_at(1);
                for (sum, v) in total.iter_mut().zip(&first[0].0) {
                    *sum += v;
                }
                *band = rest;
            }
            for (column, v) in moments.iter_mut().zip(total) {
                column[lane] = v;
            }
        }
        group_backward::<S, DYNAMIC, ISO>(s, chunk, c, eye, *group, &moments, out, &mut camera);
    }
    let camera: [[f32; LANES]; 10] = each!(10, i => camera[i].to_array());
    camera.map(|lanes| lanes.iter().map(|&v| f64::from(v)).sum())
}

#[inline(always)]
fn group_backward<S: Simd, const DYNAMIC: bool, const ISO: bool>(
    s: S,
    chunk: &Chunk,
    c: &Columns<'_>,
    eye: &Eye,
    group: Group,
    sums: &[[f32; LANES]; Sums::LEN],
    out: &mut ChunkGradient<'_>,
    camera: &mut [f32x16<S>; 10],
) {
    let at = group.at as usize;
    let row = chunk.rows.start + at;
    let moments = Moments {
        weight: f32x16::from_slice(s, &sums[Sums::WEIGHT]),
        first: each!(2, k => f32x16::from_slice(s, &sums[Sums::FIRST[k]])),
        second: each!(3, k => f32x16::from_slice(s, &sums[Sums::SECOND[k]])),
        depth: f32x16::from_slice(s, &sums[Sums::DEPTH]),
    };
    let d_rgb: [f32x16<S>; 3] = each!(3, k => f32x16::from_slice(s, &sums[Sums::RGB[k]]));
    let mut splat: Slice<S> = slice::life::<S, DYNAMIC>(s, c, row, eye.t);
    let place = project::place(s, eye, &splat.mean);
    slice::shape::<S, ISO>(s, c, row, &mut splat);
    let ellipse = project::ellipse::<S, ISO>(s, eye, &place, &splat);
    let d = project::backward::<S, ISO>(s, eye, &place, &splat, &ellipse, &moments);
    let sight = sight(s, c, eye, &place.offset, splat.dt);
    let seen_from = shade::backward(s, c, row, &sight, eye.inverse_period, &d_rgb, &mut out.columns, at);
    let logit = load(s, c.get(Column::Opacity, 0), row, 0.0);
    let d_logit = moments.weight * (all(s, 1.0) - sigmoid(s, logit));
    store(d_logit, out.columns[c.layout.column(Column::Opacity)], at);
    let gradient = SliceGradient {
        mean: each!(3, k => d.mean[k] + seen_from.offset[k]),
        log_scale: d.log_scale,
        axes: d.axes,
        log_marginal: moments.weight,
        time_mean: seen_from.time_mean,
    };
    slice::backward::<S, DYNAMIC, ISO>(s, c, row, &splat, &gradient, &mut out.columns, at);

    let on = mask32x16::from_bitmask(s, u64::from(group.seen));
    let zero = all(s, 0.0);
    for i in 0..3 {
        let tau = d.point[i] + dot(&all3(s, &eye.rotation[i]), &seen_from.offset);
        camera[i] += on.select(tau, zero);
        camera[3 + i] += on.select(d.omega[i], zero);
    }
    for i in 0..2 {
        camera[6 + i] += on.select(d.focal[i], zero);
        camera[8 + i] += on.select(d.centre[i], zero);
    }
    let centre = [d.centre[0].to_array(), d.centre[1].to_array()];
    // composited somewhere: every blended pixel adds to a colour's sum, or had no gradient to give
    let colour = d_rgb[0].abs() + d_rgb[1].abs() + d_rgb[2].abs();
    let size = moments.weight.abs() + moments.depth.abs() + colour;
    let touched = bits(size.simd_gt(zero)) & group.seen;
    for lane in lanes(touched) {
        out.touched[at + lane] = 1;
        out.means2d[at + lane] = [centre[0][lane], centre[1][lane]];
    }
}
