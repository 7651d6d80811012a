//! The SIMD twin: bands of tile rows, each with its own copy of the splats that touch it.
//!
//! The image is cut into bands of [`BAND_TILES`] tile rows. A band holds the projected splats that
//! reach it, one cache line each, in the order of their rows in memory. So a band's blending works on
//! some hundred kilobytes that stay in the second-level cache, its gradients go to memory of its own,
//! and no two threads write to the same place: bands are tasks, and results do not depend on how many
//! threads there are.
//!
//! A band is cut into blocks of two tile columns. A block's list names the splats that reach it by
//! their place in the band, near to far, and with each the tiles of the block that it reaches, as
//! bits ([`Entry`]): one entry stands for up to [`BLOCK_TILES`] entries of tile lists.

use super::{TILE, order::Order};
use crate::simd::LANES;
use fearless_simd::{Simd, prelude::*, u32x4, u32x16};
use fearless_simd_macros::simd;

/// Tile rows a band.
pub(crate) const BAND_TILES: usize = 4;
/// Pixel rows a band.
pub(crate) const BAND_ROWS: usize = BAND_TILES * TILE;
/// Tile columns a block.
pub(crate) const BLOCK_COLUMNS: usize = 2;
/// Tiles a block, row by row.
pub(crate) const BLOCK_TILES: usize = BLOCK_COLUMNS * BAND_TILES;
/// Pixel columns a block.
pub(crate) const BLOCK_WIDTH: usize = BLOCK_COLUMNS * TILE;

/// One projected splat in one band: a cache line.
///
/// `alpha = 2^e`, `e = log_opacity - (a dx^2 + b dx dy + c dy^2)` with `d = centre - pixel`: the conic
/// is scaled by `log2(e)`, and `a`, `c` by one half besides.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C, align(64))]
pub(crate) struct Record {
    pub(crate) x: f32,
    pub(crate) y: f32,
    pub(crate) a: f32,
    pub(crate) b: f32,
    pub(crate) c: f32,
    pub(crate) log_opacity: f32,
    pub(crate) rgb: [f32; 3],
    pub(crate) depth: f32,
    /// Tiles of each tile row of the band that the splat reaches: first in the low half, end in the high
    /// half, 0 for none.
    pub(crate) spans: [u32; BAND_TILES],
    pub(crate) unused: [u32; 2],
}

/// Tiles `first..end` of a row as one number; 0 for none.
#[cfg(test)]
pub(crate) fn span(first: u32, end: u32) -> u32 {
    end << 16 | first
}

/// A splat in a block: its place in the band in the low half, above it a bit for each tile of the block
/// that it reaches.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Entry(u64);

impl Entry {
    #[inline(always)]
    pub(crate) fn new(index: u32, tiles: u32) -> Self {
        Self(u64::from(tiles) << 32 | u64::from(index))
    }

    #[inline(always)]
    pub(crate) fn index(self) -> usize {
        self.0 as u32 as usize
    }

    #[inline(always)]
    pub(crate) fn tiles(self) -> u32 {
        (self.0 >> 32) as u32
    }
}

/// The splats and lists of one band.
#[derive(Debug, Default)]
pub(crate) struct Band {
    /// In the order of the rows in memory.
    pub(crate) records: Vec<Record>,
    /// Where the splats of each chunk of rows start in `records`.
    pub(crate) chunk_start: Vec<usize>,
    /// Block after block, near to far.
    pub(crate) lists: Vec<Entry>,
    /// `[blocks + 1]`: where each block's list starts.
    list_start: Vec<u32>,
    order: Order,
    /// Of each record.
    footprints: Vec<Footprint>,
    cursor: Vec<u32>,
}

/// The blocks and tiles that a record reaches.
#[derive(Debug, Clone, Copy, Default)]
struct Footprint {
    /// For each tile row [`WINDOW`] bits, one for each of the first tiles of its range of blocks.
    tiles: u64,
    index: u32,
    /// The range of blocks.
    first: u16,
    end: u16,
}

/// Tiles of a row in [`Footprint::tiles`].
const WINDOW: u32 = 16;
/// Footprints that are looked up together, in the order of depth: many loads at once, where entering
/// one would wait for each.
const BATCH: usize = 64;
/// Records whose spans are looked at together.
const GROUP: usize = LANES / BAND_TILES;

impl Band {
    /// Takes the splats of every chunk, in order.
    #[inline(always)]
    pub(crate) fn collect<'a, S: Simd>(&mut self, s: S, chunks: impl Iterator<Item = &'a [Record]>) {
        self.records.clear();
        self.footprints.clear();
        self.chunk_start.clear();
        self.order.clear();
        for part in chunks {
            let start = self.records.len();
            self.chunk_start.push(start);
            self.records.extend_from_slice(part);
            self.order.extend(part.iter().map(|r| r.depth));
            self.footprints.resize(self.records.len(), Footprint::default());
            footprints(s, part, start as u32, &mut self.footprints[start..]);
        }
    }

    /// Builds the lists of `blocks_x` blocks.
    pub(crate) fn build(&mut self, blocks_x: usize) {
        // a range adds 1 at its first block and takes it off after its last; the running sum is the count
        self.cursor.clear();
        self.cursor.resize(blocks_x + 1, 0);
        for footprint in &self.footprints {
            let (first, end) = (usize::from(footprint.first), usize::from(footprint.end));
            self.cursor[first] = self.cursor[first].wrapping_add(1);
            self.cursor[end] = self.cursor[end].wrapping_sub(1);
        }
        self.list_start.clear();
        let (mut total, mut count) = (0u32, 0u32);
        for change in &mut self.cursor {
            count = count.wrapping_add(*change);
            *change = total;
            self.list_start.push(total);
            total += count;
        }
        // one place more, for entries that are none
        self.lists.resize(total as usize + 1, Entry::default());
        self.order.sort();
        let mut batch = [Footprint::default(); BATCH];
        for start in (0..self.order.len()).step_by(BATCH) {
            let count = (self.order.len() - start).min(BATCH);
            for (n, footprint) in batch[..count].iter_mut().enumerate() {
                *footprint = self.footprints[self.order.index(start + n) as usize];
            }
            for footprint in &batch[..count] {
                self.enter(footprint, total);
            }
        }
        self.lists.truncate(total as usize);
    }

    /// Enters a record into the lists of its blocks; `nowhere` is the place for entries that are none.
    #[inline(always)]
    fn enter(&mut self, footprint: &Footprint, nowhere: u32) {
        let (first, end) = (usize::from(footprint.first), usize::from(footprint.end));
        let Footprint { tiles, index, .. } = *footprint;
        let blocks = end - first;
        // few ranges are longer than two, and none of known length: two are entered always, and the
        // second falls into nowhere where there is none
        for k in 0..2 {
            let inside = blocks > k;
            let x = (first + k).min(self.cursor.len() - 1);
            let at = if inside { self.cursor[x] } else { nowhere };
            self.lists[at as usize] = Entry::new(index, block_tiles(tiles, k));
            self.cursor[x] += u32::from(inside);
        }
        for k in 2..blocks {
            let tiles = if k < WINDOW as usize / BLOCK_COLUMNS {
                block_tiles(tiles, k)
            } else {
                far_tiles(&self.records[index as usize].spans, first + k)
            };
            let at = &mut self.cursor[first + k];
            self.lists[*at as usize] = Entry::new(index, tiles);
            *at += 1;
        }
    }

    /// Entries of all tile lists.
    pub(crate) fn pairs(&self) -> usize {
        self.lists.iter().map(|e| e.tiles().count_ones() as usize).sum()
    }

    /// The list of a block.
    #[inline(always)]
    pub(crate) fn list(&self, block: usize) -> &[Entry] {
        &self.lists[self.list_start[block] as usize..self.list_start[block + 1] as usize]
    }
}

/// The bits of block `k` of a range: two of each of the four rows, next to each other.
#[inline(always)]
fn block_tiles(tiles: u64, k: usize) -> u32 {
    let rows = tiles >> (BLOCK_COLUMNS * k) & 0x0003_0003_0003_0003;
    // the product has row r at bit 48 + 2 r: it was at 16 r
    (rows.wrapping_mul(1 << 48 | 1 << 34 | 1 << 20 | 1 << 6) >> 48) as u32 & 0xff
}

/// The same for blocks past [`WINDOW`].
#[cold]
fn far_tiles(spans: &[u32; BAND_TILES], block: usize) -> u32 {
    let mut tiles = 0;
    for (row, &s) in spans.iter().enumerate() {
        for c in 0..BLOCK_COLUMNS {
            let on = (s & 0xffff..s >> 16).contains(&((block * BLOCK_COLUMNS + c) as u32));
            tiles |= u32::from(on) << (row * BLOCK_COLUMNS + c);
        }
    }
    tiles
}

/// What each record of a chunk reaches; `start` is the index of the first.
#[simd]
fn footprints<S: Simd>(s: S, records: &[Record], start: u32, out: &mut [Footprint]) {
    let k = |v: u32| u32x16::splat(s, v);
    let none = [0; BAND_TILES];
    let mut index = start;
    for (group, out) in records.chunks(GROUP).zip(out.chunks_mut(GROUP)) {
        let row = |n: usize| u32x4::from_slice(s, group.get(n).map_or(&none, |r| &r.spans));
        let spans: u32x16<S> = row(0).combine(row(1)).combine(row(2).combine(row(3)));
        let end = spans >> 16u32;
        let first = spans.simd_eq(k(0)).select(k(0xffff), spans & k(0xffff));
        // the lanes of a record all get its least and its greatest
        let least = first.min(first.slide_within_blocks::<1>(first));
        let least = least.min(least.slide_within_blocks::<2>(least)) & k(!1);
        let most = end.max(end.slide_within_blocks::<1>(end));
        let most = most.max(most.slide_within_blocks::<2>(most));
        let low = (first - least).min(k(WINDOW));
        let high = (end.max(least) - least).min(k(WINDOW));
        // bits low..high; none where the row has none: low is at its greatest there, high is 0
        let bits = ((k(1) << high) - k(1)) & (k(0) - (k(1) << low));
        let range_end = (most + k(1)) >> 1u32;
        let range = (least >> 1u32).min(range_end) | range_end << 16u32;
        let (bits, range): ([u32; LANES], [u32; LANES]) = (bits.to_array(), range.to_array());
        for (n, footprint) in out.iter_mut().enumerate() {
            let row = |r: usize| u64::from(bits[BAND_TILES * n + r]) << (WINDOW as usize * r);
            let range = range[BAND_TILES * n];
            *footprint = Footprint {
                tiles: row(0) | row(1) | row(2) | row(3),
                index,
                first: range as u16,
                end: (range >> 16) as u16,
            };
            index += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{BAND_TILES, BLOCK_COLUMNS, Band, Record, span};
    use crate::simd::{SimdLevel, dispatch};
    use m4_math::CounterRng;

    #[test]
    fn lists_hold_every_pair_once_near_to_far() {
        for n in [0, 1, 700, 5000] {
            let mut rng = CounterRng::new(n as u64, 0, 0);
            let blocks_x = 30;
            let mut band = Band::default();
            let records: Vec<Record> = (0..n)
                .map(|_| Record {
                    depth: 0.5 + (rng.uniform() * 20.0).floor() as f32,
                    spans: std::array::from_fn(|_| {
                        let (a, b) = (rng.below(61) as u32, rng.below(61) as u32);
                        if a < b { span(a, b) } else { 0 }
                    }),
                    ..Record::default()
                })
                .collect();
            dispatch!(SimdLevel::best().level(), s => band.collect(s, records.chunks(100)));
            band.build(blocks_x);
            for (tile, row) in (0..BLOCK_COLUMNS * blocks_x).flat_map(|x| (0..BAND_TILES).map(move |y| (x, y))) {
                let mut want: Vec<usize> = (0..n)
                    .filter(|&i| {
                        let s = records[i].spans[row];
                        (s & 0xffff..s >> 16).contains(&(tile as u32))
                    })
                    .collect();
                want.sort_by(|&i, &j| records[i].depth.total_cmp(&records[j].depth));
                let bit = 1 << (row * BLOCK_COLUMNS + tile % BLOCK_COLUMNS);
                let list = band.list(tile / BLOCK_COLUMNS).iter();
                let got: Vec<usize> = list.filter(|e| e.tiles() & bit != 0).map(|e| e.index()).collect();
                assert_eq!(got, want, "tile {tile} of row {row} of {n} splats");
            }
        }
    }
}
