//! The SIMD version: one vector is a tile of 4x4 pixels, and each tile processes its own list.
//!
//! A block's list is cut into chunks; for each chunk, every tile gets the list of the entries that
//! reach it ([`Shares`]), so that no vector is spent on a tile that a splat does not reach. No branch in
//! the loops depends on a pixel. The transmittance of a pixel goes on falling after the pixel is
//! finished: it never rises, so one test against [`T_MIN`] tells for each splat whether it is still
//! blended; what it was at the end is kept apart.

mod backward;
mod forward;
mod score;

pub(crate) use self::{backward::backward, forward::forward, score::score};

use super::{ALPHA_MAX, ALPHA_MIN, T_MIN, planes::BandPlace};
use crate::{
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
/// The transmittance of finished pixels is put back here after every batch: far down are numbers that
/// are slow on some processors, and few batches get there.
const T_FLOOR: f32 = 0.5 * T_MIN as f32;

/// What a splat's gradient is made of: sums over pixels of
/// `omega = dL/d(alpha) alpha`, of `omega` times powers of `d = centre - pixel`, and of the channel
/// gradients times the weight of the splat.
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
    pub(crate) const DEPTH: usize = 7;
}

/// What the forward pass leaves of a band's lists for the passes after it: the entries that each tile
/// needed before all its pixels were finished, in whole batches.
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
        Replay { len: self.len.iter(), places: &self.places }
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
        Self { places: [[0; 256]; BLOCK_TILES], len: 0 }
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
const COLUMN: [f32; 16] = [0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3.];
const ROW: [f32; 16] = [0., 0., 0., 0., 1., 1., 1., 1., 2., 2., 2., 2., 3., 3., 3., 3.];
const _: () = assert!(TILE == 4, "the tables above are for tiles of 4x4 pixels");

impl<S: Simd> Pixels<S> {
    #[inline(always)]
    fn new(s: S, place: BandPlace, block: usize, tile: usize) -> Self {
        let (x, y) = place.corner(block, tile);
        Self { x: f32x16::from_slice(s, &COLUMN) + all(s, x as f32), y: f32x16::from_slice(s, &ROW) + all(s, y as f32) }
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

/// [`crate::simd::exp2`] with terms that need not wait for each other: half of the blending is this.
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
    e.simd_ge(all(s, (ALPHA_MIN as f32).log2())).select(alpha, all(s, 0.0))
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
    Step { weight: pass.select(alpha * t, all(s, 0.0)), t: next, pass }
}

#[cfg(test)]
mod tests;
