//! The SIMD version: one vector is a tile of 4x4 pixels, and each tile processes its own list.
//!
//! A block's list is cut into chunks; for each chunk, every tile gets the list of the entries that
//! reach it ([`Shares`]), so that no vector is spent on a tile that a splat does not reach. No
//! branch in the loops depends on a pixel. The transmittance of a pixel goes on falling after the
//! pixel is finished: it never rises, so one test against [`T_MIN`] tells for each splat whether it
//! is still blended; what it was at the end is kept apart.

mod backward;
mod forward;

pub(crate) use self::{
    backward::backward,
    forward::{forward, score},
};

use super::planes::BandPlace;
use crate::{
    ellipse::{ALPHA_MAX, ALPHA_MIN, T_MIN},
    simd::all,
    tile_binning::{
        TILE,
        cpu::{BLOCK_TILES, Entry, Record},
        handover::Row,
    },
};
use fearless_simd::{Simd, f32x16, mask32x16, prelude::*, u32x16};

/// Entries of a block's list that are shared out at a time; a place in it fits into a byte.
const CHUNK: usize = 128;
/// Entries of a tile's list that go through one stage after another, and after which it is tested
/// whether all pixels are finished.
const BATCH: usize = 16;
/// The transmittance of finished pixels is put back here after every batch: far down are numbers
/// that are slow on some processors, and few batches get there.
const T_FLOOR: f32 = 0.5 * T_MIN as f32;

/// What a splat's gradient is made of: sums over pixels of `omega = dL/d(alpha) alpha`, of `omega`
/// times powers of `d = centre - pixel`, and of the channel gradients times the weight of the
/// splat.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C, align(64))]
pub(crate) struct Sums(pub(crate) [f32; 16]);

impl Sums {
    // sums of omega in even lanes, of the weight in odd ones: see `backward`
    pub(crate) const WEIGHT: usize = 0;
    /// `dx`, `dy`.
    pub(crate) const FIRST: [usize; 2] = [2, 4];
    /// `dx dx`, `dx dy`, `dy dy`.
    pub(crate) const SECOND: [usize; 3] = [6, 8, 10];
    pub(crate) const RGB: [usize; 3] = [1, 3, 5];
}

/// What the forward pass leaves of a band's lists for the passes after it: the entries that each
/// tile needed before all its pixels were finished, in whole batches.
#[derive(Debug, Clone, Default)]
pub(crate) struct Used {
    /// Of each block: entries of its list in chunks that some pixel was unfinished before.
    walked: Vec<u32>,
    /// Of each chunk of each block: entries of each tile.
    len: Vec<[u8; BLOCK_TILES]>,
    /// Their places in the chunk, tile after tile, chunk after chunk.
    places: Vec<u8>,
}

impl Used {
    fn clear(&mut self) {
        self.walked.clear();
        self.len.clear();
        self.places.clear();
    }

    /// Entries of all tiles.
    pub(crate) fn total(&self) -> usize {
        self.places.len()
    }

    fn replay(&self) -> Replay<'_> {
        Replay {
            len: self.len.iter(),
            places: &self.places,
        }
    }
}

/// Reads [`Used`] again, in the order in which it was written.
struct Replay<'a> {
    len: std::slice::Iter<'a, [u8; BLOCK_TILES]>,
    places: &'a [u8],
}

impl<'a> Replay<'a> {
    /// The places of each tile in the next chunk.
    fn chunk(&mut self) -> [&'a [u8]; BLOCK_TILES] {
        let len = self.len.next().copied().unwrap_or_default();
        len.map(|len| {
            let (places, rest) = self.places.split_at(usize::from(len));
            self.places = rest;
            places
        })
    }
}

/// The splats of a chunk of a block's list, copied side by side: the copies are many loads at once,
/// where the blending would wait for each.
type Copies = [Record; CHUNK];

#[inline(always)]
fn copy(chunk: &[Entry], rows: &[Row], copies: &mut Copies) {
    for (entry, copy) in chunk.iter().zip(copies) {
        *copy = Record::of(&rows[entry.row()]);
    }
}

/// Which entries of a chunk reach each tile of the block.
#[derive(Debug)]
struct Shares {
    /// For each tile places in the chunk; one more is written than counts.
    places: [[u8; 256]; BLOCK_TILES],
    /// How many: a byte for each tile.
    len: u64,
}

/// A bit of the index in each byte.
static SPREAD: [u64; 1 << BLOCK_TILES] = {
    let mut out = [0; 1 << BLOCK_TILES];
    let mut set = 0;
    while set < out.len() {
        let mut bit = 0;
        while bit < BLOCK_TILES {
            out[set] |= (set as u64 >> bit & 1) << (8 * bit);
            bit += 1;
        }
        set += 1;
    }
    out
};

impl Shares {
    fn new() -> Self {
        Self {
            places: [[0; 256]; BLOCK_TILES],
            len: 0,
        }
    }

    /// Shares out a chunk: every tile is offered every entry, and moves on if the entry is its own.
    #[inline(always)]
    fn fill(&mut self, chunk: &[Entry]) {
        let mut len = 0u64;
        for (place, entry) in chunk.iter().take(CHUNK).enumerate() {
            for (tile, places) in self.places.iter_mut().enumerate() {
                places[(len >> (8 * tile)) as u8 as usize] = place as u8;
            }
            len += SPREAD[entry.tiles() as u8 as usize];
        }
        self.len = len;
    }

    #[inline(always)]
    fn of(&self, tile: usize) -> &[u8] {
        &self.places[tile][..(self.len >> (8 * tile)) as u8 as usize]
    }
}

/// The coordinates of a tile's pixels in the image.
#[derive(Clone, Copy)]
struct Pixels<S: Simd> {
    x: f32x16<S>,
    y: f32x16<S>,
}

/// Column and row of each pixel of a tile.
const COLUMN: [f32; 16] = [
    0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3.,
];
const ROW: [f32; 16] = [
    0., 0., 0., 0., 1., 1., 1., 1., 2., 2., 2., 2., 3., 3., 3., 3.,
];
const _: () = assert!(TILE == 4, "the tables above are for tiles of 4x4 pixels");

impl<S: Simd> Pixels<S> {
    #[inline(always)]
    fn new(s: S, place: BandPlace, block: usize, tile: usize) -> Self {
        let (x, y) = place.corner(block, tile);
        Self {
            x: f32x16::from_slice(s, &COLUMN) + all(s, x as f32),
            y: f32x16::from_slice(s, &ROW) + all(s, y as f32),
        }
    }
}

/// The exponent of `alpha` (base 2) over a tile (docs/spec/optimiser.md 1.7).
#[inline(always)]
fn exponent<S: Simd>(s: S, r: &Record, pixels: &Pixels<S>) -> f32x16<S> {
    let dx = all(s, r.x) - pixels.x;
    let dy = all(s, r.y) - pixels.y;
    let slope = all(s, r.b).mul_add(dy, all(s, r.a) * dx);
    let flat = (all(s, -r.c) * dy).mul_add(dy, all(s, r.log_opacity));
    (-slope).mul_add(dx, flat)
}

/// [`crate::simd::exp2`] with terms that need not wait for each other: half of the blending is
/// this.
#[inline(always)]
fn power<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    let k = |v: f32| all(s, v);
    let shifted = x + k(12_582_912.0);
    let f = x - (shifted - k(12_582_912.0));
    let ff = f * f;
    let low = k(0.693_146_95).mul_add(f, k(1.0));
    let middle = k(0.055_507_133).mul_add(f, k(0.240_221_2));
    let high = k(0.001_327_646).mul_add(f, k(0.009_675_541));
    let p = high.mul_add(ff, middle).mul_add(ff, low);
    let exponent: u32x16<S> = shifted.to_bits();
    f32x16::from_bits(p.to_bits() + (exponent << 23u32))
}

/// `alpha` of a splat on a tile: at most [`ALPHA_MAX`], 0 where it is under [`ALPHA_MIN`].
#[inline(always)]
fn alpha<S: Simd>(s: S, r: &Record, pixels: &Pixels<S>) -> f32x16<S> {
    let e = exponent(s, r, pixels);
    // where e is below its limit the power may be anything, NaN too: it is not selected
    let alpha = power(s, e).min(all(s, ALPHA_MAX as f32));
    e.simd_ge(all(s, (ALPHA_MIN as f32).log2()))
        .select(alpha, all(s, 0.0))
}

/// What sixteen pixels do with one splat.
#[derive(Clone, Copy)]
struct Step<S: Simd> {
    /// `T alpha`; 0 where it is not blended.
    weight: f32x16<S>,
    /// `T (1 - alpha)`.
    t: f32x16<S>,
    /// Where the pixel is not finished after it.
    pass: mask32x16<S>,
}

/// The transmittance from before a splat to after it.
#[inline(always)]
fn step<S: Simd>(s: S, alpha: f32x16<S>, t: f32x16<S>) -> Step<S> {
    let next = (-alpha).mul_add(t, t);
    let pass = next.simd_ge(all(s, T_MIN as f32));
    Step {
        weight: pass.select(alpha * t, all(s, 0.0)),
        t: next,
        pass,
    }
}

#[cfg(test)]
mod tests {
    use super::{BATCH, CHUNK, Sums, Used, backward, forward, score};
    use crate::{
        SimdLevel,
        blend::planes::{BandGradient, BandPlace, BandPlanes},
        ellipse::{ALPHA_MIN, LOG2_ALPHA_MIN},
        simd::dispatch,
        tile_binning::{
            TILE,
            cpu::{BAND_ROWS, BAND_TILES, Band, Record, span},
            handover::tests::hand_over,
        },
    };
    use m4_core::CounterRng;

    const PLACE: BandPlace = BandPlace {
        top: 32,
        rows: 13,
        width: 45,
    };

    fn random_records(n: usize, log_opacity: f64) -> Vec<Record> {
        let mut rng = CounterRng::new(5, n as u64, 0);
        (0..n)
            .map(|_| {
                let (turn, long, short) = (
                    3.0 * rng.uniform(),
                    0.5 + 6.0 * rng.uniform(),
                    0.4 + rng.uniform(),
                );
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
                    let dx =
                        f64::from(record.x) - f64::from(tile) * TILE as f64 - (p % TILE) as f64;
                    let dy = f64::from(record.y) - (PLACE.top + row * TILE + p / TILE) as f64;
                    let [a, b, c, l] =
                        [record.a, record.b, record.c, record.log_opacity].map(f64::from);
                    // a hair more, for the rounding of f32
                    l - a * dx * dx - b * dx * dy - c * dy * dy >= ALPHA_MIN.log2() - 1e-3
                })
            };
            let mut tiles = (0..tiles_x).filter(|&tile| everything || reached(tile));
            tiles.next().map_or(0, |first| {
                span(first, tiles.next_back().unwrap_or(first) + 1)
            })
        })
    }

    /// Frame, gradients, score, and how much of the lists was used.
    fn run(level: SimdLevel, records: &[Record], everything: bool) -> (Vec<f32>, [f64; 3], usize) {
        let n = PLACE.rows * PLACE.width;
        let mut band = Band::default();
        let splats: Vec<_> = records.iter().map(|r| (*r, spans(r, everything))).collect();
        let (rows, chunks) = hand_over(level, &splats, 50);
        band.collect(&rows, chunks.iter(), PLACE.blocks());
        band.build();
        let mut planes = vec![vec![0.0f32; n]; 5];
        let mut used = Used::default();
        let [r, g, b, t, z] = planes.get_disjoint_mut([0, 1, 2, 3, 4]).unwrap();
        let mut out = BandPlanes {
            rgb: [r, g, b],
            transmittance: t,
            depth: z,
        };
        dispatch!(level.level(), s => forward(s, &band, &rows, PLACE, [0.3, 0.2, 0.1], &mut out, &mut used));
        let gradient = |k: u64| -> Vec<f32> {
            let mut rng = CounterRng::new(6, k, 0);
            (0..n).map(|_| (2.0 * rng.uniform() - 1.0) as f32).collect()
        };
        let v: Vec<Vec<f32>> = (0..3).map(gradient).collect();
        let g = BandGradient {
            rgb: [&planes[0], &planes[1], &planes[2]],
            transmittance: &planes[3],
            d_rgb: [&v[0], &v[1], &v[2]],
        };
        let mut sums = Vec::new();
        let background =
            dispatch!(level.level(), s => backward(s, &band, &rows, PLACE, &used, &g, &mut sums));
        let mut scores = Vec::new();
        let weight: Vec<f32> = v[0].iter().map(|w| w.abs()).collect();
        dispatch!(level.level(), s => score(s, &band, &rows, PLACE, &used, &weight, &mut scores));
        let sums = sums.iter().flat_map(|s: &Sums| s.0);
        let all = planes
            .iter()
            .flatten()
            .copied()
            .chain(sums)
            .chain(scores)
            .collect();
        (all, background, used.total())
    }

    #[test]
    fn tiles_that_a_splat_does_not_reach_may_be_left_out() {
        const { assert!(BAND_ROWS == 16, "the band below is cut off at its 13th row") };
        // a few, several chunks, and a stack in which pixels end early
        for (n, log_opacity) in [(BATCH - 1, -3.0), (3 * CHUNK + 7, -5.0), (4 * CHUNK, -0.2)] {
            let records = random_records(n, log_opacity);
            for level in SimdLevel::available() {
                let name = format!("{n} splats on {level}");
                let (some, some_background, some_used) = run(level, &records, false);
                let (all, all_background, all_used) = run(level, &records, true);
                assert!(some == all && some_background == all_background, "{name}");
                assert!(some.iter().all(|v| v.is_finite()), "{name}");
                assert!(
                    some_used > n && 2 * some_used < all_used,
                    "{name}: {some_used} of {all_used}"
                );
            }
        }
    }

    #[test]
    fn the_least_exponent_is_the_logarithm_of_the_least_alpha() {
        assert!((LOG2_ALPHA_MIN - ALPHA_MIN.log2()).abs() < 1e-14);
    }
}
