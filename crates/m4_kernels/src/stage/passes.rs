//! Columns to the records of the bands, and their moments back to gradients of the columns.

use crate::{
    blend::cpu::Sums,
    ellipse::ALPHA_MIN,
    project::cpu::{self as project, Ellipse, Eye, Moments},
    shade::cpu::{self as shade, Sight},
    simd::{
        FETCH_ROWS, LANES, all, all3, bits, dot, each, lanes, load, log2, sigmoid, store, touch,
        transpose, turn,
    },
    slice::cpu::{self as slice, Columns, Slice, SliceGradient},
    stage::{BandLanes, CameraSums, Chunk, ChunkGradient, Group},
    tile_binning::handover::{Extent, FIELDS, Row},
};
use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};
use fearless_simd_macros::simd;
use m4_core::Column;
use std::f32::consts::LOG2_E;

#[simd]
pub(super) fn chunk_forward<S: Simd, const DYNAMIC: bool, const ISO: bool>(
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
    if left >= LANES {
        u16::MAX
    } else {
        (1 << left) - 1
    }
}

/// One over the length of a vector from the camera, and the unit vector.
#[inline(always)]
pub(super) fn sight<S: Simd>(
    s: S,
    c: &Columns<'_>,
    eye: &Eye,
    offset: &[f32x16<S>; 3],
    dt: f32x16<S>,
) -> Sight<S> {
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
    let lanes = emit(s, chunk, at, eye, &ellipse, &extent);
    if lanes == 0 {
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
    chunk.groups.push(Group {
        at: at as u32,
        lanes,
        parts_end: chunk.parts.len() as u32,
    });
    if DYNAMIC {
        chunk.marginals.push(splat.marginal.to_array());
    }
}

/// Hands the splats of a group to their bands; returns those that reach a tile.
#[inline(always)]
fn emit<S: Simd>(
    s: S,
    chunk: &mut Chunk,
    at: usize,
    eye: &Eye,
    ellipse: &Ellipse<S>,
    extent: &Extent<S>,
) -> u16 {
    let row = (chunk.place + at) as u32;
    let mut visible_lanes = 0;
    for band in extent.bands() {
        // neighbours are mostly in neighbouring bands, but need not be
        if !extent.may_reach(s, band) {
            continue;
        }
        let reach = extent.reach(s, eye, ellipse, band);
        let lanes = reach.lanes(s);
        if lanes != 0 {
            chunk.bands[band].push(s, row, lanes, &reach);
            chunk.parts.push(BandLanes {
                band: band as u16,
                lanes,
            });
            visible_lanes |= lanes;
        }
    }
    visible_lanes
}

#[simd]
pub(super) fn chunk_backward<S: Simd, const DYNAMIC: bool, const ISO: bool>(
    s: S,
    chunk: &Chunk,
    c: &Columns<'_>,
    eye: &Eye,
    sums: &mut [&[Sums]],
    with_camera: bool,
    out: &mut ChunkGradient<'_>,
) -> CameraSums {
    let zero = all(s, 0.0);
    let mut camera = with_camera.then_some([zero; 10]);
    // groups jump between the bands: read in order, their sums come from far memory much faster
    let lines = sums
        .iter()
        .zip(&chunk.bands)
        .flat_map(|(sums, band)| &sums[..band.splats()]);
    for line in lines {
        // one after the other: of a sum the compiler makes gathers, which are slower
        std::hint::black_box(line.0[0]);
    }
    // the few columns of one colour per splat the processor fetches as well on its own
    let many = c.layout.colour_terms() > 1;
    let (mut from, mut fetched) = (0, 0);
    for group in &chunk.groups {
        if many && group.at as usize >= fetched {
            let at = group.at as usize;
            c.fetch::<DYNAMIC>(chunk.rows.start + at);
            out.columns.iter().for_each(|column| touch(column, at));
            fetched = at + FETCH_ROWS;
        }
        let mut totals = [zero; LANES];
        for part in &chunk.parts[from..group.parts_end as usize] {
            let band = &mut sums[usize::from(part.band)];
            let (here, rest) = band.split_at(part.lanes.count_ones() as usize);
            for (lane, sum) in lanes(part.lanes).zip(here) {
                totals[lane] += f32x16::from_slice(s, &sum.0);
            }
            *band = rest;
        }
        from = group.parts_end as usize;
        group_backward::<S, DYNAMIC, ISO>(s, chunk, c, eye, *group, &totals, out, &mut camera);
    }
    let Some(camera) = camera else {
        return CameraSums::default();
    };
    let camera: [[f32; LANES]; 10] = each!(10, i => camera[i].to_array());
    camera.map(|lanes| lanes.iter().map(|&v| f64::from(v)).sum())
}

/// `totals[lane]` holds the sums of that splat, in the order of [`Sums`].
#[inline(always)]
fn group_backward<S: Simd, const DYNAMIC: bool, const ISO: bool>(
    s: S,
    chunk: &Chunk,
    c: &Columns<'_>,
    eye: &Eye,
    group: Group,
    totals: &[f32x16<S>; LANES],
    out: &mut ChunkGradient<'_>,
    camera: &mut Option<[f32x16<S>; 10]>,
) {
    let at = group.at as usize;
    let row = chunk.rows.start + at;
    let sums = transpose(totals);
    let sum = |k: usize| f32x16::from_slice(s, &sums[k]);
    let moments = Moments {
        weight: sum(Sums::WEIGHT),
        first: each!(2, k => sum(Sums::FIRST[k])),
        second: each!(3, k => sum(Sums::SECOND[k])),
    };
    let d_rgb: [f32x16<S>; 3] = each!(3, k => sum(Sums::RGB[k]));
    let mut splat: Slice<S> = slice::life::<S, DYNAMIC>(s, c, row, eye.t);
    let place = project::place(s, eye, &splat.mean);
    slice::shape::<S, ISO>(s, c, row, &mut splat);
    let ellipse = project::ellipse::<S, ISO>(s, eye, &place, &splat);
    let d = project::backward::<S, ISO>(s, eye, &splat, &ellipse, &moments);
    if !out.image.is_empty() {
        let half = [eye.width, eye.height].map(|side| all(s, 0.5 * side as f32));
        let [x, y] = each!(2, k => d.centre[k] * half[k]);
        store((x * x + y * y).sqrt(), out.image, at);
    }
    let sight = sight(s, c, eye, &place.offset, splat.dt);
    let seen_from = shade::backward(
        s,
        c,
        row,
        &sight,
        eye.inverse_period,
        &d_rgb,
        &mut out.columns,
        at,
    );
    let logit = load(s, c.opacity, row, 0.0);
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

    let zero = all(s, 0.0);
    if let Some(camera) = camera {
        let on = mask32x16::from_bitmask(s, u64::from(group.lanes));
        let lens = project::lens_backward(s, eye, &place, &ellipse, &d);
        for i in 0..3 {
            let tau = d.point[i] + dot(&all3(s, &eye.rotation[i]), &seen_from.offset);
            camera[i] += on.select(tau, zero);
            camera[3 + i] += on.select(lens.omega[i], zero);
        }
        for i in 0..2 {
            camera[6 + i] += on.select(lens.focal[i], zero);
            camera[8 + i] += on.select(d.centre[i], zero);
        }
    }
    // composited somewhere: every blended pixel adds to a colour's sum, or had no gradient to give
    let colour = d_rgb[0].abs() + d_rgb[1].abs() + d_rgb[2].abs();
    let size = moments.weight.abs() + colour;
    let touched = bits(size.simd_gt(zero)) & group.lanes;
    match out.touched.get_mut(at..at + LANES) {
        Some(flags) => {
            for (lane, flag) in flags.iter_mut().enumerate() {
                *flag = (touched >> lane & 1) as u8;
            }
        }
        None => {
            for (lane, flag) in out.touched[at..].iter_mut().enumerate() {
                *flag = (touched >> lane & 1) as u8;
            }
        }
    }
}
