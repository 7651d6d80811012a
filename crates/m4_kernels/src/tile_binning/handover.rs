//! The data that the projection passes to the bands: every splat once ([`Row`]), and for each band the splats that reach it, and their
//! tiles.

use super::cpu::{BAND_TILES, BLOCK_COLUMNS};
use crate::simd::{LANES, bits as bits_of, each, lanes as lanes_of};
use fearless_simd::{Simd, mask32x16, prelude::*, u32x16};

/// Numbers of a projected splat.
pub(crate) const FIELDS: usize = 10;
/// A projected splat, the numbers of a [`Record`](super::cpu::Record) side by side. It lies where its row
/// is, sixteen a group; rows of groups that are not in the image hold what they held.
pub(crate) type Row = [f32; FIELDS];
/// Tiles of a row, from the first of the blocks reached on, that have a bit in [`Part::tiles`].
pub(super) const WINDOW: u32 = 16;
/// Blocks whose tiles have bits there.
pub(super) const WINDOW_BLOCKS: u32 = WINDOW / BLOCK_COLUMNS as u32;
/// First tile of a row that is not reached.
const NONE: u32 = 0xffff;

/// The splats of a group of sixteen that reach a band.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    /// Of the first lane.
    pub(super) row: u32,
    pub(super) lanes: u16,
    /// For each splat and each tile row of the band [`WINDOW`] bits, one for each of the first tiles of its
    /// range of blocks; two rows per number.
    pub(super) tiles: [[u32; LANES]; BAND_TILES / 2],
    /// For each splat the range of blocks that it reaches: first in the low half, end in the high half.
    pub(super) range: [u32; LANES],
}

/// What one band gets of one chunk.
#[derive(Debug, Default)]
pub(crate) struct Handover {
    pub(super) parts: Vec<Part>,
    /// Spans of the splats that reach more than [`WINDOW_BLOCKS`] blocks, in their order.
    pub(super) far: Vec<[u32; BAND_TILES]>,
    splats: usize,
}

impl Handover {
    pub(crate) fn clear(&mut self) {
        self.parts.clear();
        self.far.clear();
        self.splats = 0;
    }

    /// Splats in all parts.
    pub(crate) fn splats(&self) -> usize {
        self.splats
    }

    /// Adds `lanes` of the group whose first row is `row`.
    #[inline(always)]
    pub(crate) fn push<S: Simd>(&mut self, s: S, row: u32, lanes: u16, reach: &Reach<S>) {
        let k = |v: u32| u32x16::splat(s, v);
        let Reach { first, end } = reach;
        let least = first[0].min(first[1]).min(first[2].min(first[3])) & k(!1);
        let most = end[0].max(end[1]).max(end[2].max(end[3]));
        let bits: [u32x16<S>; BAND_TILES] = each!(BAND_TILES, r => {
            let low = (first[r] - least).min(k(WINDOW));
            let high = (end[r].max(least) - least).min(k(WINDOW));
            // bits low..high; none where the row has none: low is at its greatest there, high is 0
            ((k(1) << high) - k(1)) & (k(0) - (k(1) << low))
        });
        let tiles = each!(2, half => (bits[2 * half] | bits[2 * half + 1] << 16u32).to_array());
        let to = (most + k(1)) >> 1u32;
        let from = (least >> 1u32).min(to);
        self.parts.push(Part { row, lanes, tiles, range: (from | to << 16u32).to_array() });
        self.splats += lanes.count_ones() as usize;
        let far = bits_of((to - from).simd_gt(k(WINDOW_BLOCKS))) & lanes;
        if far != 0 {
            self.push_far(
                far,
                &each!(BAND_TILES, r => first[r].to_array()),
                &each!(BAND_TILES, r => end[r].to_array()),
            );
        }
    }

    #[cold]
    fn push_far(&mut self, far: u16, first: &[[u32; LANES]; BAND_TILES], end: &[[u32; LANES]; BAND_TILES]) {
        for lane in lanes_of(far) {
            let span = |r: usize| {
                if end[r][lane] == 0 { 0 } else { end[r][lane] << 16 | first[r][lane] }
            };
            self.far.push(std::array::from_fn(span));
        }
    }
}

/// The tiles of a band's rows that sixteen splats reach: in each row from the first to before the end.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reach<S: Simd> {
    first: [u32x16<S>; BAND_TILES],
    end: [u32x16<S>; BAND_TILES],
}

impl<S: Simd> Reach<S> {
    /// No tile.
    #[inline(always)]
    pub(super) fn none(s: S) -> Self {
        Self { first: [u32x16::splat(s, NONE); BAND_TILES], end: [u32x16::splat(s, 0); BAND_TILES] }
    }

    /// Lanes of `hit` reach the tiles `first..end` of `row`, the others none.
    #[inline(always)]
    pub(super) fn set(&mut self, row: usize, hit: mask32x16<S>, first: u32x16<S>, end: u32x16<S>) {
        self.first[row] = hit.select(first, self.first[row]);
        self.end[row] = hit.select(end, self.end[row]);
    }

    /// Lanes that reach a tile.
    #[inline(always)]
    pub(crate) fn lanes(&self, s: S) -> u16 {
        let end = self.end[0] | self.end[1] | self.end[2] | self.end[3];
        bits_of(end.simd_gt(u32x16::splat(s, 0)))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::{BAND_TILES, Handover, Reach, Row};
    use crate::{
        SimdLevel,
        simd::{LANES, dispatch, each},
        tile_binning::cpu::Record,
    };
    use fearless_simd::{Simd, prelude::*, u32x16};

    /// What a band gets of these records and their spans, in chunks of `chunk`.
    pub(crate) fn hand_over(
        level: SimdLevel,
        splats: &[(Record, [u32; BAND_TILES])],
        chunk: usize,
    ) -> (Vec<Row>, Vec<Handover>) {
        let (mut rows, mut out) = (Vec::new(), Vec::new());
        for splats in splats.chunks(chunk) {
            let mut handover = Handover::default();
            for splats in splats.chunks(LANES) {
                let (mut first, mut end) = ([[0; LANES]; BAND_TILES], [[0; LANES]; BAND_TILES]);
                for (lane, (_, spans)) in splats.iter().enumerate() {
                    for row in 0..BAND_TILES {
                        (first[row][lane], end[row][lane]) = (spans[row] & 0xffff, spans[row] >> 16);
                    }
                }
                let (row, lanes) = (rows.len() as u32, u16::MAX >> (LANES - splats.len()));
                dispatch!(level.level(), s => push(s, row, lanes, &first, &end, &mut handover));
                rows.extend(splats.iter().map(|(record, _)| record.row()));
                rows.resize(rows.len().next_multiple_of(LANES), Row::default());
            }
            out.push(handover);
        }
        (rows, out)
    }

    #[inline(always)]
    fn push<S: Simd>(
        s: S,
        row: u32,
        lanes: u16,
        first: &[[u32; LANES]; BAND_TILES],
        end: &[[u32; LANES]; BAND_TILES],
        out: &mut Handover,
    ) {
        let mut reach = Reach::none(s);
        let load = |v: &[u32; LANES]| u32x16::from_slice(s, v);
        each!(BAND_TILES, row => {
            let end = load(&end[row]);
            reach.set(row, end.simd_gt(u32x16::splat(s, 0)), load(&first[row]), end);
        });
        out.push(s, row, lanes, &reach);
    }
}
