//! The SIMD twin: bands of tile rows, each with its own copy of the splats that touch it.
//!
//! The image is cut into bands of [`BAND_TILES`] tile rows. A band holds the projected splats that
//! reach it, one cache line each, in the order of their rows in memory; its tile lists name them by
//! their place in the band, near to far. So a band's blending works on some hundred kilobytes that
//! stay in the second-level cache, its gradients go to memory of its own, and no two threads write to
//! the same place: bands are tasks, and results do not depend on how many threads there are.

use super::TILE;

/// Tile rows a band.
pub(crate) const BAND_TILES: usize = 2;
/// Pixel rows a band.
pub(crate) const BAND_ROWS: usize = BAND_TILES * TILE;

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
    pub(crate) unused: [u32; 4],
}

/// Tiles `first..end` of a row as one number; 0 for none.
#[cfg(test)]
pub(crate) fn span(first: u32, end: u32) -> u32 {
    end << 16 | first
}

/// First tile and end of an entry of [`Record::spans`].
#[inline(always)]
fn unspan(span: u32) -> (usize, usize) {
    ((span & 0xffff) as usize, (span >> 16) as usize)
}

/// The splats and tile lists of one band.
#[derive(Debug, Default)]
pub(crate) struct Band {
    /// In the order of the rows in memory.
    pub(crate) records: Vec<Record>,
    /// Where the splats of each chunk of rows start in `records`.
    pub(crate) chunk_start: Vec<usize>,
    /// Indices into `records`, tile after tile, near to far.
    pub(crate) lists: Vec<u32>,
    /// `[tiles + 1]`: where each tile's list starts.
    pub(crate) list_start: Vec<u32>,
    keys: Vec<u64>,
    keys_other: Vec<u64>,
    cursor: Vec<u32>,
}

impl Band {
    /// Takes the splats of every chunk, in order.
    pub(crate) fn collect<'a>(&mut self, chunks: impl Iterator<Item = &'a [Record]>) {
        self.records.clear();
        self.chunk_start.clear();
        for part in chunks {
            self.chunk_start.push(self.records.len());
            self.records.extend_from_slice(part);
        }
    }

    /// Builds the tile lists of `tiles_x` tiles a row.
    pub(crate) fn build(&mut self, tiles_x: usize) {
        self.sort();
        let tiles = tiles_x * BAND_TILES;
        // a span adds 1 at its first tile and takes it off after its last; the running sum is the count
        self.cursor.clear();
        self.cursor.resize((tiles_x + 1) * BAND_TILES, 0);
        for record in &self.records {
            for (row, &s) in record.spans.iter().enumerate() {
                let (first, end) = unspan(s);
                let row = &mut self.cursor[row * (tiles_x + 1)..][..tiles_x + 1];
                row[first] = row[first].wrapping_add(1);
                row[end] = row[end].wrapping_sub(1);
            }
        }
        self.list_start.clear();
        let mut total = 0u32;
        for row in 0..BAND_TILES {
            let mut count = 0u32;
            for x in 0..tiles_x {
                count = count.wrapping_add(self.cursor[row * (tiles_x + 1) + x]);
                self.list_start.push(total);
                total += count;
            }
        }
        self.list_start.push(total);
        self.cursor.clear();
        self.cursor.extend_from_slice(&self.list_start[..tiles]);
        self.lists.clear();
        self.lists.resize(total as usize, 0);
        for &key in &self.keys {
            let index = key as u32;
            let record = &self.records[index as usize];
            for (row, &s) in record.spans.iter().enumerate() {
                let (first, end) = unspan(s);
                for at in &mut self.cursor[row * tiles_x + first..row * tiles_x + end] {
                    self.lists[*at as usize] = index;
                    *at += 1;
                }
            }
        }
    }

    /// The list of a tile.
    #[inline(always)]
    pub(crate) fn list(&self, tile: usize) -> &[u32] {
        &self.lists[self.list_start[tile] as usize..self.list_start[tile + 1] as usize]
    }

    /// Fills `keys` with the indices of the records, near to far, ties in the order of the rows:
    /// a radix sort by the bits of the depth, which is above 0.
    fn sort(&mut self) {
        const DIGIT: u32 = 11;
        const SIZE: usize = 1 << DIGIT;
        let keys = self.records.iter().enumerate();
        self.keys.clear();
        self.keys
            .extend(keys.map(|(i, r)| u64::from(r.depth.to_bits()) << 32 | i as u64));
        if self.keys.len() < 512 {
            self.keys.sort_unstable();
            return;
        }
        let mut counts = [[0u32; SIZE]; 3];
        for &key in &self.keys {
            for (pass, count) in counts.iter_mut().enumerate() {
                count[(key >> (32 + DIGIT as usize * pass)) as usize % SIZE] += 1;
            }
        }
        self.keys_other.resize(self.keys.len(), 0);
        for (pass, count) in counts.iter_mut().enumerate() {
            let mut start = 0;
            for c in count.iter_mut() {
                (start, *c) = (start + *c, start);
            }
            for &key in &self.keys {
                let at = &mut count[(key >> (32 + DIGIT as usize * pass)) as usize % SIZE];
                self.keys_other[*at as usize] = key;
                *at += 1;
            }
            std::mem::swap(&mut self.keys, &mut self.keys_other);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Band, Record, span};
    use m4_math::CounterRng;

    #[test]
    fn lists_hold_every_pair_once_near_to_far() {
        for n in [0, 1, 700, 5000] {
            let mut rng = CounterRng::new(n as u64, 0, 0);
            let tiles_x = 7;
            let mut band = Band::default();
            let records: Vec<Record> = (0..n)
                .map(|_| Record {
                    depth: 0.5 + (rng.uniform() * 20.0).floor() as f32,
                    spans: std::array::from_fn(|_| {
                        let (a, b) = (rng.below(8) as u32, rng.below(8) as u32);
                        if a < b { span(a, b) } else { 0 }
                    }),
                    ..Record::default()
                })
                .collect();
            band.collect(records.chunks(100));
            band.build(tiles_x);
            for tile in 0..tiles_x * super::BAND_TILES {
                let mut want: Vec<u32> = (0..n as u32)
                    .filter(|&i| {
                        let s = records[i as usize].spans[tile / tiles_x];
                        (s & 0xffff..s >> 16).contains(&((tile % tiles_x) as u32))
                    })
                    .collect();
                want.sort_by(|&i, &j| records[i as usize].depth.total_cmp(&records[j as usize].depth));
                assert_eq!(band.list(tile), want, "tile {tile} of {n} splats");
            }
        }
    }
}
