//! Sums a map of weights over the pixels that each splat is blended on (Minute4D Eq. 9).

use super::{CHUNK, Pixels, T_FLOOR, Used, alpha, copy, step};
use crate::{
    blend::planes::BandPlace,
    simd::{all, each},
    tile_binning::{
        cpu::{BLOCK_TILES, Band, Record},
        handover::Row,
    },
};
use fearless_simd::{Simd, f32x16, prelude::*};
use fearless_simd_macros::simd;

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
        let mut t: [f32x16<S>; BLOCK_TILES] =
            each!(BLOCK_TILES, tile => f32x16::from_slice(s, &place.window(block, tile).fresh(1.0, T_FLOOR)));
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
