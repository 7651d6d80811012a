//! Slice, project and shade in one pass over the columns, and the same way back.
//!
//! Rows are cut into fixed chunks, static and dynamic rows apart; a chunk is a task. Forward, it hands
//! one [`Record`] to every band that a splat reaches. Backward, it collects the moments of its splats
//! from the bands, in the order of the bands, and turns them into gradients of the columns.

use crate::{
    bin::cpu::{BAND_TILES, Record},
    blend::{ALPHA_MIN, cpu::Sums},
    project::cpu::{self as project, Ellipse, Eye, Moments},
    shade::cpu::{self as shade, Sight},
    simd::{LANES, all, bits, dot, load, log2, sigmoid, store},
    slice::cpu::{self as slice, Columns, Slice, SliceGradient},
};
use fearless_simd::{Simd, f32x16, mask32x16, prelude::*, u32x16};
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

/// The lanes of a set of bits, in order.
fn lanes(mut set: u16) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = set.trailing_zeros() as usize;
        set &= set.wrapping_sub(1);
        (lane < LANES).then_some(lane)
    })
}

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
        direction = offset.map(|v| v * inverse_distance);
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
    let fields = [
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
    ]
    .map(|v| v.to_array());
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
        if ty < top || ty > bottom { 0 } else { spans[ty - top][lane] }
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
        unused: [0; 3],
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

/// Which tile rows sixteen ellipses reach, and where.
#[derive(Debug, Clone, Copy)]
struct Extent<S: Simd> {
    on: mask32x16<S>,
    /// Squared Mahalanobis radius at which alpha falls under the threshold.
    radius: f32x16<S>,
    half_height: f32x16<S>,
    /// Vertical offset of the rightmost point.
    right_at: f32x16<S>,
    /// Variance across at a fixed row, slope of the conditional mean.
    across: f32x16<S>,
    slope: f32x16<S>,
    inverse_11: f32x16<S>,
    top: [f32; LANES],
    bottom: [f32; LANES],
}

/// Covers the rounding of coordinates, pixels.
const SLACK_PX: f32 = 0.005;
/// Covers the rounding of alpha, relative.
const SLACK: f32 = 0.002;

impl<S: Simd> Extent<S> {
    #[inline(always)]
    fn new(s: S, eye: &Eye, e: &Ellipse<S>, opacity: f32x16<S>, on: mask32x16<S>) -> Self {
        let k = |v: f32| all(s, v);
        let [v00, v01, v11] = e.covariance;
        let strength = on.select(opacity, k(1.0)) * k(1.0 / ALPHA_MIN as f32);
        let radius = (log2(s, strength) * k(2.0 * std::f32::consts::LN_2) + k(SLACK)).max(k(0.0));
        let half_width = (radius * v00).sqrt() + k(SLACK_PX);
        let half_height = (radius * v11).sqrt() + k(SLACK_PX);
        let (w, h) = (eye.width as f32, eye.height as f32);
        let top = (e.v - half_height).ceil().max(k(0.0));
        let bottom = (e.v + half_height).floor().min(k(h - 1.0));
        let left = (e.u - half_width).ceil().max(k(0.0));
        let right = (e.u + half_width).floor().min(k(w - 1.0));
        let on = on & top.simd_le(bottom) & left.simd_le(right);
        let tile = |y: f32x16<S>| on.select((y * k(0.125)).floor(), k(0.0));
        Self {
            on,
            radius,
            half_height,
            right_at: v01 * (radius / v00).sqrt(),
            across: e.det / v11,
            slope: v01 / v11,
            inverse_11: k(1.0) / v11,
            top: tile(top).to_array(),
            bottom: tile(bottom).to_array(),
        }
    }

    /// Fills `spans[k]` with the tiles of row `top + k`; lanes that are out hold anything.
    #[inline(always)]
    fn rows(&mut self, s: S, eye: &Eye, e: &Ellipse<S>, on: u16, spans: &mut Vec<[u32; LANES]>) {
        let k = |v: f32| all(s, v);
        let count = lanes(on)
            .map(|lane| (self.bottom[lane] - self.top[lane]) as usize + 1)
            .max()
            .unwrap_or(0);
        spans.resize(spans.len().max(count), [0; LANES]);
        let top = f32x16::from_slice(s, &self.top) * k(8.0) - e.v;
        let (w, zero) = (k(eye.width as f32 - 1.0), k(0.0));
        for (row, out) in spans[..count].iter_mut().enumerate() {
            let first = top + k(8.0 * row as f32);
            let low = first.max(-self.half_height);
            let high = (first + k(7.0)).min(self.half_height);
            let edge = |at: f32x16<S>| {
                let y = at.max(low).min(high);
                let reach = ((self.radius - y * y * self.inverse_11) * self.across).max(zero).sqrt();
                (e.u + self.slope * y, reach + k(SLACK_PX))
            };
            let (middle, reach) = edge(self.right_at);
            let right = (middle + reach).floor().min(w);
            let (middle, reach) = edge(-self.right_at);
            let left = (middle - reach).ceil().max(zero);
            let hit = low.simd_le(high) & left.simd_le(right);
            let (left, right) = (hit.select(left, zero), hit.select(right, k(-8.0)));
            let first: u32x16<S> = (left * k(0.125)).to_int::<u32x16<S>>();
            let end: u32x16<S> = ((right + k(8.0)) * k(0.125)).to_int::<u32x16<S>>();
            (first + (end << 16u32)).store_slice(out);
        }
    }
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
    camera.map(|v| v.to_array().iter().map(|&lane| f64::from(lane)).sum())
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
    let get = |index: usize| f32x16::from_slice(s, &sums[index]);
    let moments = Moments {
        weight: get(Sums::WEIGHT),
        first: Sums::FIRST.map(get),
        second: Sums::SECOND.map(get),
        depth: get(Sums::DEPTH),
    };
    let mut splat: Slice<S> = slice::life::<S, DYNAMIC>(s, c, row, eye.t);
    let place = project::place(s, eye, &splat.mean);
    slice::shape::<S, ISO>(s, c, row, &mut splat);
    let ellipse = project::ellipse::<S, ISO>(s, eye, &place, &splat);
    let d = project::backward::<S, ISO>(s, eye, &place, &splat, &ellipse, &moments);
    let sight = sight(s, c, eye, &place.offset, splat.dt);
    let seen_from = shade::backward(
        s,
        c,
        row,
        &sight,
        eye.inverse_period,
        &Sums::RGB.map(get),
        &mut out.columns,
        at,
    );
    let logit = load(s, c.get(Column::Opacity, 0), row, 0.0);
    let d_logit = moments.weight * (all(s, 1.0) - sigmoid(s, logit));
    store(d_logit, out.columns[c.layout.column(Column::Opacity)], at);
    let gradient = SliceGradient {
        mean: std::array::from_fn(|k| d.mean[k] + seen_from.offset[k]),
        log_scale: d.log_scale,
        axes: d.axes,
        log_marginal: moments.weight,
        time_mean: seen_from.time_mean,
    };
    slice::backward::<S, DYNAMIC, ISO>(s, c, row, &splat, &gradient, &mut out.columns, at);

    let on = mask32x16::from_bitmask(s, u64::from(group.seen));
    let mut add = |index: usize, v: f32x16<S>| camera[index] += on.select(v, all(s, 0.0));
    for i in 0..3 {
        add(i, d.point[i] + dot(&eye.rotation[i].map(|v| all(s, v)), &seen_from.offset));
        add(3 + i, d.omega[i]);
    }
    for i in 0..2 {
        add(6 + i, d.focal[i]);
        add(8 + i, d.centre[i]);
    }
    let centre = d.centre.map(|v| v.to_array());
    // composited somewhere: every blended pixel adds to a colour's sum, or had no gradient to give
    let size = Sums::RGB.map(get).into_iter().fold(moments.weight.abs() + moments.depth.abs(), |a, v| a + v.abs());
    let touched = bits(size.simd_gt(all(s, 0.0))) & group.seen;
    for lane in lanes(touched) {
        out.touched[at + lane] = 1;
        out.means2d[at + lane] = [centre[0][lane], centre[1][lane]];
    }
}
