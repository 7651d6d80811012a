//! What the lists leave out changes nothing.

use super::{BATCH, CHUNK, Sums, Used, backward, forward, score};
use crate::{
    SimdLevel,
    blend::{
        ALPHA_MIN, LOG2_ALPHA_MIN,
        planes::{BandGradient, BandPlace, BandPlanes},
    },
    simd::dispatch,
    tile_binning::{
        TILE,
        cpu::{BAND_ROWS, BAND_TILES, Band, Record, span},
        handover::tests::hand_over,
    },
};
use m4_core::CounterRng;

const PLACE: BandPlace = BandPlace { top: 32, rows: 13, width: 45 };

fn random_records(n: usize, log_opacity: f64) -> Vec<Record> {
    let mut rng = CounterRng::new(5, n as u64, 0);
    (0..n)
        .map(|_| {
            let (turn, long, short) = (3.0 * rng.uniform(), 0.5 + 6.0 * rng.uniform(), 0.4 + rng.uniform());
            let (cos, sin) = (turn.cos(), turn.sin());
            let (p, q) = (1.0 / (long * long), 1.0 / (short * short));
            Record {
                x: (-4.0 + 53.0 * rng.uniform()) as f32,
                y: (28.0 + 24.0 * rng.uniform()) as f32,
                a: (p * cos * cos + q * sin * sin) as f32,
                b: (2.0 * (p - q) * cos * sin) as f32,
                c: (p * sin * sin + q * cos * cos) as f32,
                log_opacity: (log_opacity * rng.uniform()) as f32,
                rgb: std::array::from_fn(|_| rng.uniform() as f32),
                depth: (1.0 + 5.0 * rng.uniform()) as f32,
            }
        })
        .collect()
}

/// The tiles of each row, all of them or from the first to the last that `record` reaches.
fn spans(record: &Record, everything: bool) -> [u32; BAND_TILES] {
    let tiles_x = PLACE.width.div_ceil(TILE) as u32;
    std::array::from_fn(|row| {
        let reached = |tile: u32| {
            (0..TILE * TILE).any(|p| {
                let dx = f64::from(record.x) - f64::from(tile) * TILE as f64 - (p % TILE) as f64;
                let dy = f64::from(record.y) - (PLACE.top + row * TILE + p / TILE) as f64;
                let [a, b, c, l] = [record.a, record.b, record.c, record.log_opacity].map(f64::from);
                // a hair more, for the rounding of f32
                l - a * dx * dx - b * dx * dy - c * dy * dy >= ALPHA_MIN.log2() - 1e-3
            })
        };
        let mut tiles = (0..tiles_x).filter(|&tile| everything || reached(tile));
        tiles.next().map_or(0, |first| span(first, tiles.next_back().unwrap_or(first) + 1))
    })
}

/// Frame, gradients, score, and how much of the lists was used.
fn run(level: SimdLevel, records: &[Record], everything: bool, extra: bool) -> (Vec<f32>, [f64; 3], usize) {
    let n = PLACE.rows * PLACE.width;
    let mut band = Band::default();
    let splats: Vec<_> = records.iter().map(|r| (*r, spans(r, everything))).collect();
    let (rows, chunks) = hand_over(level, &splats, 50);
    band.collect(&rows, chunks.iter(), PLACE.blocks());
    band.build();
    let mut planes = vec![vec![0.0f32; n]; 5];
    let mut used = Used::default();
    let [r, g, b, t, z] = planes.get_disjoint_mut([0, 1, 2, 3, 4]).unwrap();
    let mut out = BandPlanes { rgb: [r, g, b], transmittance: t, depth: if extra { z } else { &mut [] } };
    dispatch!(level.level(), s => forward(s, &band, &rows, PLACE, [0.3, 0.2, 0.1], &mut out, &mut used));
    let gradient = |k: u64| -> Vec<f32> {
        let mut rng = CounterRng::new(6, k, 0);
        (0..n).map(|_| (2.0 * rng.uniform() - 1.0) as f32).collect()
    };
    let v: Vec<Vec<f32>> = (0..5).map(gradient).collect();
    let g = BandGradient {
        rgb: [&planes[0], &planes[1], &planes[2]],
        transmittance: &planes[3],
        depth: if extra { &planes[4] } else { &[] },
        d_rgb: [&v[0], &v[1], &v[2]],
        d_alpha: if extra { &v[3] } else { &[] },
        d_depth: if extra { &v[4] } else { &[] },
    };
    let mut sums = Vec::new();
    let background = dispatch!(level.level(), s => backward(s, &band, &rows, PLACE, &used, &g, &mut sums));
    let mut scores = Vec::new();
    let weight: Vec<f32> = v[0].iter().map(|w| w.abs()).collect();
    dispatch!(level.level(), s => score(s, &band, &rows, PLACE, &used, &weight, &mut scores));
    let sums = sums.iter().flat_map(|s: &Sums| s.0);
    let all = planes.iter().flatten().copied().chain(sums).chain(scores).collect();
    (all, background, used.total())
}

#[test]
fn tiles_that_a_splat_does_not_reach_may_be_left_out() {
    const { assert!(BAND_ROWS == 16, "the band below is cut off at its 13th row") };
    // a few, several chunks, and a stack in which pixels end early
    for (n, log_opacity) in [(BATCH - 1, -3.0), (3 * CHUNK + 7, -5.0), (4 * CHUNK, -0.2)] {
        let records = random_records(n, log_opacity);
        for level in SimdLevel::available() {
            for extra in [false, true] {
                let name = format!("{n} splats on {level}, depth and alpha {extra}");
                let (some, some_background, some_used) = run(level, &records, false, extra);
                let (all, all_background, all_used) = run(level, &records, true, extra);
                assert!(some == all && some_background == all_background, "{name}");
                assert!(some.iter().all(|v| v.is_finite()), "{name}");
                assert!(some_used > n && 2 * some_used < all_used, "{name}: {some_used} of {all_used}");
            }
        }
    }
}

#[test]
fn the_least_exponent_is_the_logarithm_of_the_least_alpha() {
    assert!((LOG2_ALPHA_MIN - ALPHA_MIN.log2()).abs() < 1e-14);
}
