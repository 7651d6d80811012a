//! The passes from near to far: splats to pixels, and sums of a map of weights over the pixels that
//! each splat is blended on (Minute4D Eq. 9).

use crate::{
    blend::{
        cpu::{BATCH, CHUNK, Copies, Pixels, Shares, T_FLOOR, Used, alpha, copy, step},
        planes::{BandPlace, BandPlanes},
    },
    ellipse::T_MIN,
    simd::{all, all3, each},
    tile_binning::{
        cpu::{BLOCK_TILES, Band, Record},
        handover::Row,
    },
};
use fearless_simd::{Simd, f32x16, prelude::*};
use fearless_simd_macros::simd;

/// Draws a band; `used` is how much of its lists it needed.
#[inline(always)]
pub(crate) fn forward<S: Simd>(
    s: S,
    band: &Band,
    rows: &[Row],
    place: BandPlace,
    background: [f32; 3],
    out: &mut BandPlanes<'_>,
    used: &mut Used,
) {
    if out.depth.is_empty() {
        band_forward::<S, false>(s, band, rows, place, background, out, used);
    } else {
        band_forward::<S, true>(s, band, rows, place, background, out, used);
    }
}

/// The pixels of a tile between two chunks.
#[derive(Clone, Copy)]
struct State<S: Simd> {
    /// Falls on after the end.
    t: f32x16<S>,
    /// What is left after the last splat that was blended.
    left: f32x16<S>,
    rgb: [f32x16<S>; 3],
    depth: f32x16<S>,
}

#[simd]
fn band_forward<S: Simd, const DEPTH: bool>(
    s: S,
    band: &Band,
    rows: &[Row],
    place: BandPlace,
    background: [f32; 3],
    out: &mut BandPlanes<'_>,
    used: &mut Used,
) {
    used.clear();
    let mut shares = Shares::new();
    let mut records = [Record::default(); CHUNK];
    let zero = all(s, 0.0);
    for block in 0..place.blocks() {
        let mut states = [State {
            t: zero,
            left: all(s, 1.0),
            rgb: [zero; 3],
            depth: zero,
        }; BLOCK_TILES];
        for (tile, state) in states.iter_mut().enumerate() {
            state.t = f32x16::from_slice(s, &place.window(block, tile).fresh(1.0, T_FLOOR));
        }
        // a bit for each tile that has an unfinished pixel
        let mut alive = u32::MAX >> (32 - BLOCK_TILES);
        let mut walked = 0;
        for chunk in band.list(block).chunks(CHUNK) {
            walked += chunk.len() as u32;
            shares.fill(chunk);
            copy(chunk, rows, &mut records);
            let mut len = [0; BLOCK_TILES];
            for (tile, state) in states.iter_mut().enumerate() {
                if alive >> tile & 1 == 0 {
                    continue;
                }
                let pixels = Pixels::new(s, place, block, tile);
                let list = shares.of(tile);
                let (count, finished) = tile_forward::<S, DEPTH>(s, list, &records, &pixels, state);
                used.places.extend_from_slice(&list[..count]);
                len[tile] = count as u8;
                alive &= !(u32::from(finished) << tile);
            }
            used.len.push(len);
            if alive == 0 {
                break;
            }
        }
        used.walked.push(walked);
        for (tile, state) in states.iter().enumerate() {
            let window = place.window(block, tile);
            for c in 0..3 {
                let colour = state.left.mul_add(all(s, background[c]), state.rgb[c]);
                window.store(colour, out.rgb[c]);
            }
            window.store(state.left, out.transmittance);
            if DEPTH {
                window.store(state.depth, out.depth);
            }
        }
    }
}

/// Blends a list onto a tile; returns how much of it was needed and whether every pixel is
/// finished.
#[inline(always)]
fn tile_forward<S: Simd, const DEPTH: bool>(
    s: S,
    list: &[u8],
    records: &Copies,
    pixels: &Pixels<S>,
    state: &mut State<S>,
) -> (usize, bool) {
    let State {
        mut t,
        mut left,
        mut rgb,
        mut depth,
    } = *state;
    let (mut count, mut finished) = (0, false);
    let mut alphas = [[0.0; 16]; BATCH];
    for batch in list.chunks(BATCH) {
        // two loops, because the processor looks only a limited number of operations ahead: the
        // second waits for itself, the first for nothing
        for (&place, row) in batch.iter().zip(&mut alphas) {
            alpha(s, &records[place as usize % CHUNK], pixels).store_slice(row);
        }
        for (&place, row) in batch.iter().zip(&alphas) {
            let r = &records[place as usize % CHUNK];
            let step = step(s, f32x16::from_slice(s, row), t);
            let colour = all3(s, &r.rgb);
            for c in 0..3 {
                rgb[c] = step.weight.mul_add(colour[c], rgb[c]);
            }
            if DEPTH {
                depth = step.weight.mul_add(all(s, r.depth), depth);
            }
            left = step.pass.select(step.t, left);
            t = step.t;
        }
        t = t.max(all(s, T_FLOOR));
        count += batch.len();
        if !t.simd_ge(all(s, T_MIN as f32)).any_true() {
            finished = true;
            break;
        }
    }
    *state = State {
        t,
        left,
        rgb,
        depth,
    };
    (count, finished)
}

/// Fills `scores[i]`, one per splat of the band: the weights of the pixels that it is blended on.
#[inline(always)]
pub(crate) fn score<S: Simd>(
    s: S,
    band: &Band,
    rows: &[Row],
    place: BandPlace,
    used: &Used,
    weight: &[f32],
    scores: &mut Vec<f32>,
) {
    band_score(s, band, rows, place, used, weight, scores);
}

#[simd]
fn band_score<S: Simd>(
    s: S,
    band: &Band,
    rows: &[Row],
    place: BandPlace,
    used: &Used,
    weight: &[f32],
    scores: &mut Vec<f32>,
) {
    scores.clear();
    scores.resize(band.splats(), 0.0);
    let (zero, floor) = (all(s, 0.0), all(s, T_FLOOR));
    let mut replay = used.replay();
    let mut records = [Record::default(); CHUNK];
    for block in 0..place.blocks() {
        let mut t: [f32x16<S>; BLOCK_TILES] = each!(BLOCK_TILES, tile => f32x16::from_slice(s, &place.window(block, tile).fresh(1.0, T_FLOOR)));
        for chunk in band.list(block)[..used.walked[block] as usize].chunks(CHUNK) {
            copy(chunk, rows, &mut records);
            for (tile, list) in replay.chunk().into_iter().enumerate() {
                let pixels = Pixels::new(s, place, block, tile);
                let weight = place.window(block, tile).load(s, weight);
                for &place in list {
                    let place = place as usize % CHUNK;
                    let step = step(s, alpha(s, &records[place], &pixels), t[tile]);
                    let sum = step.weight.simd_gt(zero).select(weight, zero);
                    scores[chunk[place].index()] += sum.reduce_sum();
                    t[tile] = step.t.max(floor);
                }
            }
        }
    }
}
