//! The SIMD version: bands of tile rows, each with lists of the splats that touch it.
//!
//! The image is cut into bands of [`BAND_TILES`] tile rows. The splats that reach a band have
//! numbers in it, in the order of their rows in memory. So a band's blending works on some hundred
//! kilobytes that stay in the second-level cache, its gradients go to memory of its own, and no two
//! threads write to the same place: bands are tasks, and results do not depend on how many threads
//! there are.
//!
//! A band is cut into blocks of two tile columns. A block's list names the splats that reach it,
//! near to far, and with each the tiles of the block that it reaches, as bits ([`Entry`]): one
//! entry stands for up to [`BLOCK_TILES`] entries of tile lists.

use super::{
    TILE,
    handover::{FIELDS, Handover, Row, WINDOW_BLOCKS},
    order::Order,
};
use crate::simd::{LANES, lanes};

/// Tile rows a band.
pub(crate) const BAND_TILES: usize = 4;
/// Pixel rows a band.
pub(crate) const BAND_ROWS: usize = BAND_TILES * TILE;
/// Tile columns per block.
pub(crate) const BLOCK_COLUMNS: usize = 2;
/// Tiles a block, row by row.
pub(crate) const BLOCK_TILES: usize = BLOCK_COLUMNS * BAND_TILES;
/// Pixel columns per block.
pub(crate) const BLOCK_WIDTH: usize = BLOCK_COLUMNS * TILE;

/// One projected splat as the blending reads it: a cache line.
///
/// `alpha = 2^e`, `e = log_opacity - (a dx^2 + b dx dy + c dy^2)` with `d = centre - pixel`: the
/// conic is scaled by `log2(e)`, and `a`, `c` by one half besides.
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
}

impl Record {
    /// Where a row has the depth: last.
    const DEPTH: usize = FIELDS - 1;

    /// The other way.
    #[cfg(test)]
    pub(crate) fn row(&self) -> Row {
        let [red, green, blue] = self.rgb;
        [
            self.x,
            self.y,
            self.a,
            self.b,
            self.c,
            self.log_opacity,
            red,
            green,
            blue,
            self.depth,
        ]
    }

    /// From what the projection wrote.
    #[inline(always)]
    pub(crate) fn of(row: &Row) -> Self {
        let [x, y, a, b, c, log_opacity, red, green, blue, depth] = *row;
        Self {
            x,
            y,
            a,
            b,
            c,
            log_opacity,
            rgb: [red, green, blue],
            depth,
        }
    }
}

/// Tiles `first..end` of a row as one number; 0 for none.
#[cfg(test)]
pub(crate) fn span(first: u32, end: u32) -> u32 {
    end << 16 | first
}

/// A splat in a block: its row, its number in the band, and a bit for each tile of the block that
/// it reaches.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Entry(u64);

/// Bits of a row and of a number: the parameters alone of this many splats take 15 GB.
const INDEX_BITS: u32 = 28;
const _: () = assert!(
    2 * INDEX_BITS as usize + BLOCK_TILES == 64,
    "an entry is a 64-bit number"
);

impl Entry {
    #[inline(always)]
    fn new(row: u32, index: u32, tiles: u32) -> Self {
        Self(u64::from(tiles) << (2 * INDEX_BITS) | u64::from(index) << INDEX_BITS | u64::from(row))
    }

    #[inline(always)]
    pub(crate) fn row(self) -> usize {
        self.0 as usize % (1 << INDEX_BITS)
    }

    #[inline(always)]
    pub(crate) fn index(self) -> usize {
        (self.0 >> INDEX_BITS) as usize % (1 << INDEX_BITS)
    }

    #[inline(always)]
    pub(crate) fn tiles(self) -> u32 {
        (self.0 >> (2 * INDEX_BITS)) as u32
    }
}

/// The splats and lists of one band.
#[derive(Debug, Default)]
pub(crate) struct Band {
    /// The number of the first splat of each chunk of rows.
    pub(crate) chunk_start: Vec<usize>,
    /// Block after block, near to far.
    pub(crate) lists: Vec<Entry>,
    /// `[blocks + 1]`: where each block's list starts.
    list_start: Vec<u32>,
    order: Order,
    /// Of each splat, in the order of the rows in memory.
    footprints: Vec<Footprint>,
    /// Spans of the splats that reach many blocks.
    far: Vec<[u32; BAND_TILES]>,
    cursor: Vec<u32>,
}

/// The blocks and tiles that a splat reaches.
#[derive(Debug, Clone, Copy, Default)]
struct Footprint {
    /// As [`BandGroup::tiles`](super::handover::BandGroup); for more than [`WINDOW_BLOCKS`] blocks
    /// the place in [`Band::far`].
    tiles: u64,
    row: u32,
    /// The range of blocks.
    first: u16,
    end: u16,
}

impl Footprint {
    #[inline(always)]
    fn is_far(&self) -> bool {
        u32::from(self.end) > u32::from(self.first) + WINDOW_BLOCKS
    }
}

/// Footprints that are looked up together, in the order of depth: many loads at once, where
/// entering one would wait for each.
const BATCH: usize = 64;

impl Band {
    /// Takes the splats of every chunk, in order, for lists of `blocks_x` blocks.
    pub(crate) fn collect<'a>(
        &mut self,
        rows: &[Row],
        chunks: impl Iterator<Item = &'a Handover> + Clone,
        blocks_x: usize,
    ) {
        // a range adds 1 at its first block and takes it off after its last; the running sum is the
        // count
        self.cursor.clear();
        self.cursor.resize(blocks_x + 1, 0);
        let total = chunks.clone().map(Handover::splats).sum();
        self.footprints.resize(total, Footprint::default());
        self.order.resize(total);
        self.chunk_start.clear();
        self.far.clear();
        let (mut start, mut least, mut most) = (0, u64::MAX, 0);
        for handover in chunks {
            self.chunk_start.push(start);
            let mut far = handover.far.iter();
            for part in &handover.parts {
                let Some(rows) = rows[part.row as usize..].first_chunk::<LANES>() else {
                    continue;
                };
                let here = start..start + part.lanes.count_ones() as usize;
                let keys = self.order.keys(here.clone());
                let footprints = self.footprints[here.clone()].iter_mut();
                let entries = lanes(part.lanes).zip(footprints).zip(keys);
                for (index, ((lane, footprint), key)) in (start as u32..).zip(entries) {
                    // this also brings the row into the cache, much faster than the blending, which
                    // looks rows up out of order
                    *key = Order::key(rows[lane][Record::DEPTH], index);
                    (least, most) = (least.min(*key), most.max(*key));
                    let range = part.range[lane];
                    *footprint = Footprint {
                        tiles: u64::from(part.tiles[1][lane]) << 32
                            | u64::from(part.tiles[0][lane]),
                        row: part.row + lane as u32,
                        first: range as u16,
                        end: (range >> 16) as u16,
                    };
                    let (first, end) = (usize::from(footprint.first), usize::from(footprint.end));
                    self.cursor[first] = self.cursor[first].wrapping_add(1);
                    self.cursor[end] = self.cursor[end].wrapping_sub(1);
                    if footprint.is_far() {
                        footprint.tiles = self.far.len() as u64;
                        self.far.extend(far.next());
                    }
                }
                start = here.end;
            }
        }
        self.order.set_range(least, most);
    }

    /// Splats that reach the band.
    pub(crate) fn splats(&self) -> usize {
        self.footprints.len()
    }

    /// Reads the rows of all splats in order, which brings them into the cache much faster than the
    /// blending, which looks them up out of order.
    pub(crate) fn touch(&self, rows: &[Row]) {
        // rows are shorter than a cache line and lie side by side: of each, one number is enough
        for footprint in &self.footprints {
            std::hint::black_box(rows[footprint.row as usize][0]);
        }
    }

    /// Builds the lists.
    pub(crate) fn build(&mut self) {
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
            for (n, footprint) in batch[..count].iter().enumerate() {
                self.enter(self.order.index(start + n), footprint, total);
            }
        }
        self.lists.truncate(total as usize);
    }

    /// Enters a splat into the lists of its blocks; `nowhere` is the place for entries that are
    /// none.
    #[inline(always)]
    fn enter(&mut self, index: u32, footprint: &Footprint, nowhere: u32) {
        if footprint.is_far() {
            return self.enter_far(index, footprint);
        }
        let (first, end) = (usize::from(footprint.first), usize::from(footprint.end));
        let Footprint { tiles, row, .. } = *footprint;
        let blocks = end - first;
        // few ranges are longer than two, and none of known length: two are entered always, and the
        // second falls into nowhere where there is none
        for k in 0..2 {
            let inside = blocks > k;
            let x = (first + k).min(self.cursor.len() - 1);
            let at = if inside { self.cursor[x] } else { nowhere };
            self.lists[at as usize] = Entry::new(row, index, block_tiles(tiles, k));
            self.cursor[x] += u32::from(inside);
        }
        for k in 2..blocks {
            let at = &mut self.cursor[first + k];
            self.lists[*at as usize] = Entry::new(row, index, block_tiles(tiles, k));
            *at += 1;
        }
    }

    /// The same for more blocks than have bits.
    #[cold]
    fn enter_far(&mut self, index: u32, footprint: &Footprint) {
        let spans = &self.far[footprint.tiles as usize];
        for block in usize::from(footprint.first)..usize::from(footprint.end) {
            let at = &mut self.cursor[block];
            self.lists[*at as usize] = Entry::new(footprint.row, index, far_tiles(spans, block));
            *at += 1;
        }
    }

    /// Entries of all tile lists.
    pub(crate) fn pairs(&self) -> usize {
        self.lists
            .iter()
            .map(|e| e.tiles().count_ones() as usize)
            .sum()
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

/// The same from the spans.
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

#[cfg(test)]
mod tests {
    use super::{BAND_TILES, BLOCK_COLUMNS, Band, Record, span};
    use crate::tile_binning::handover::tests::hand_over;
    use m4_core::CounterRng;
    use m4_core::SimdLevel;

    #[test]
    fn lists_hold_every_pair_once_near_to_far() {
        for n in [0, 1, 700, 5000] {
            let mut rng = CounterRng::new(n as u64, 0, 0);
            let blocks_x = 30;
            let mut band = Band::default();
            let splats: Vec<(Record, [u32; BAND_TILES])> = (0..n)
                .map(|_| {
                    let record = Record {
                        depth: 0.5 + (rng.uniform() * 20.0).floor() as f32,
                        ..Record::default()
                    };
                    let spans = std::array::from_fn(|_| {
                        let (a, b) = (rng.below(61) as u32, rng.below(61) as u32);
                        if a < b { span(a, b) } else { 0 }
                    });
                    (record, spans)
                })
                .collect();
            let (rows, chunks) = hand_over(SimdLevel::best(), &splats, 100);
            band.collect(&rows, chunks.iter(), blocks_x);
            band.build();
            for (tile, row) in
                (0..BLOCK_COLUMNS * blocks_x).flat_map(|x| (0..BAND_TILES).map(move |y| (x, y)))
            {
                let mut want: Vec<usize> = (0..n)
                    .filter(|&i| {
                        let s = splats[i].1[row];
                        (s & 0xffff..s >> 16).contains(&(tile as u32))
                    })
                    .collect();
                want.sort_by(|&i, &j| splats[i].0.depth.total_cmp(&splats[j].0.depth));
                let bit = 1 << (row * BLOCK_COLUMNS + tile % BLOCK_COLUMNS);
                let list = band.list(tile / BLOCK_COLUMNS).iter();
                let got: Vec<usize> = list
                    .filter(|e| e.tiles() & bit != 0)
                    .map(|e| e.index())
                    .collect();
                assert_eq!(got, want, "tile {tile} of row {row} of {n} splats");
            }
        }
    }
}
