//! The data that the projection passes to the bands: every splat once ([`Row`]), and for each band
//! the splats that reach it, with the exact extent of their tiles row by row
//! (docs/spec/optimiser.md 5.2).

use crate::{
    ellipse::ALPHA_MIN,
    project::cpu::{Ellipse, Eye},
    simd::{LANES, all, bits as bits_of, each, lanes as lanes_of},
    tile_binning::{
        TILE,
        cpu::{BAND_TILES, BLOCK_COLUMNS},
    },
};
use fearless_simd::{Simd, f32x16, i32x16, mask32x16, prelude::*, u32x16};
use std::ops::RangeInclusive;

/// Numbers of a projected splat.
pub(crate) const FIELDS: usize = 10;
/// A projected splat, the numbers of a [`Record`](super::cpu::Record) side by side. It lies where
/// its row is, sixteen a group; rows of groups that are not in the image hold what they held.
pub(crate) type Row = [f32; FIELDS];
/// Tiles of a row, from the first of the blocks reached on, that have a bit in
/// [`BandGroup::tiles`].
pub(super) const WINDOW: u32 = 16;
/// Blocks whose tiles have bits there.
pub(super) const WINDOW_BLOCKS: u32 = WINDOW / BLOCK_COLUMNS as u32;
/// First tile of a row that is not reached.
const NONE: u32 = 0xffff;

/// The splats of a group of sixteen that reach a band.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BandGroup {
    /// Of the first lane.
    pub(super) row: u32,
    pub(super) lanes: u16,
    /// For each splat and each tile row of the band [`WINDOW`] bits, one for each of the first
    /// tiles of its range of blocks; two rows per number.
    pub(super) tiles: [[u32; LANES]; BAND_TILES / 2],
    /// For each splat the range of blocks that it reaches: first in the low half, end in the high
    /// half.
    pub(super) range: [u32; LANES],
}

/// What one band gets of one chunk.
#[derive(Debug, Default)]
pub(crate) struct Handover {
    pub(super) parts: Vec<BandGroup>,
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
        self.parts.push(BandGroup {
            row,
            lanes,
            tiles,
            range: (from | to << 16u32).to_array(),
        });
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
    fn push_far(
        &mut self,
        far: u16,
        first: &[[u32; LANES]; BAND_TILES],
        end: &[[u32; LANES]; BAND_TILES],
    ) {
        for lane in lanes_of(far) {
            let span = |r: usize| {
                if end[r][lane] == 0 {
                    0
                } else {
                    end[r][lane] << 16 | first[r][lane]
                }
            };
            self.far.push(std::array::from_fn(span));
        }
    }
}

/// The tiles of a band's rows that sixteen splats reach: in each row from the first to before the
/// end.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reach<S: Simd> {
    first: [u32x16<S>; BAND_TILES],
    end: [u32x16<S>; BAND_TILES],
}

impl<S: Simd> Reach<S> {
    /// No tile.
    #[inline(always)]
    pub(super) fn none(s: S) -> Self {
        Self {
            first: [u32x16::splat(s, NONE); BAND_TILES],
            end: [u32x16::splat(s, 0); BAND_TILES],
        }
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
                        (first[row][lane], end[row][lane]) =
                            (spans[row] & 0xffff, spans[row] >> 16);
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

/// Which tile rows sixteen ellipses reach, and where.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Extent<S: Simd> {
    /// Lanes that may reach the image.
    pub(crate) on: mask32x16<S>,
    /// Squared Mahalanobis radius at which alpha falls under the threshold.
    radius: f32x16<S>,
    half_height: f32x16<S>,
    /// Vertical offset of the rightmost point.
    right_at: f32x16<S>,
    /// Variance across at a fixed row, slope of the conditional mean.
    across: f32x16<S>,
    slope: f32x16<S>,
    inverse_11: f32x16<S>,
    /// First and last tile row; where a lane is off none is between them.
    top: f32x16<S>,
    bottom: f32x16<S>,
}

/// The edge of a tile and its inverse.
const EDGE: f32 = TILE as f32;
const INVERSE_EDGE: f32 = 1.0 / EDGE;
/// Covers the rounding of coordinates, pixels.
const SLACK_PX: f32 = 0.005;
/// Covers the rounding of alpha, relative.
const SLACK: f32 = 0.002;

impl<S: Simd> Extent<S> {
    #[inline(always)]
    pub(crate) fn new(
        s: S,
        eye: &Eye,
        e: &Ellipse<S>,
        log_opacity: f32x16<S>,
        on: mask32x16<S>,
    ) -> Self {
        let k = |v: f32| all(s, v);
        let [v00, v01, v11] = e.covariance;
        let strength = on.select(log_opacity, k(0.0)) - k((ALPHA_MIN as f32).log2());
        let radius = (strength * k(2.0 * std::f32::consts::LN_2) + k(SLACK)).max(k(0.0));
        let (reach_x, reach_y) = ((radius * v00).sqrt(), (radius * v11).sqrt());
        let (half_width, half_height) = (reach_x + k(SLACK_PX), reach_y + k(SLACK_PX));
        let inverse_11 = k(1.0) / v11;
        let (w, h) = (eye.width as f32, eye.height as f32);
        let top = (e.v - half_height).ceil().max(k(0.0));
        let bottom = (e.v + half_height).floor().min(k(h - 1.0));
        let left = (e.u - half_width).ceil().max(k(0.0));
        let right = (e.u + half_width).floor().min(k(w - 1.0));
        let on = on & top.simd_le(bottom) & left.simd_le(right);
        Self {
            on,
            radius,
            half_height,
            right_at: v01 * reach_x / v00,
            across: e.det * inverse_11,
            slope: v01 * inverse_11,
            inverse_11,
            top: on.select((top * k(INVERSE_EDGE)).floor(), k(f32::MAX)),
            bottom: on.select((bottom * k(INVERSE_EDGE)).floor(), k(-1.0)),
        }
    }

    /// Middle and half width at the vertical offset `y`.
    #[inline(always)]
    fn across(&self, s: S, e: &Ellipse<S>, y: f32x16<S>) -> (f32x16<S>, f32x16<S>) {
        let left = (self.radius - y * y * self.inverse_11) * self.across;
        let reach = left.max(all(s, 0.0)).sqrt() + all(s, SLACK_PX);
        (e.u + self.slope * y, reach)
    }

    /// The bands from the first to the last that one may reach; a lane must be on.
    #[inline(always)]
    pub(crate) fn bands(&self) -> RangeInclusive<usize> {
        let (first, last) = (
            self.top.reduce_min() as usize,
            self.bottom.reduce_max() as usize,
        );
        first / BAND_TILES..=last / BAND_TILES
    }

    /// Whether one may reach a band.
    #[inline(always)]
    pub(crate) fn may_reach(&self, s: S, band: usize) -> bool {
        let row = (band * BAND_TILES) as f32;
        let above = self.top.simd_le(all(s, row + (BAND_TILES - 1) as f32));
        (above & self.bottom.simd_ge(all(s, row))).any_true()
    }

    /// The tiles of a band.
    #[inline(always)]
    pub(crate) fn reach(&self, s: S, eye: &Eye, e: &Ellipse<S>, band: usize) -> Reach<S> {
        let k = |v: f32| all(s, v);
        let (w, zero) = (k(eye.width as f32 - 1.0), k(0.0));
        let mut out = Reach::none(s);
        for row in 0..BAND_TILES {
            let tile = (band * BAND_TILES + row) as f32;
            let first = k(EDGE * tile) - e.v;
            let low = first.max(-self.half_height);
            let high = (first + k(EDGE - 1.0)).min(self.half_height);
            let (middle, reach) = self.across(s, e, self.right_at.max(low).min(high));
            let right = (middle + reach).floor().min(w);
            let (middle, reach) = self.across(s, e, (-self.right_at).max(low).min(high));
            let left = (middle - reach).ceil().max(zero);
            let hit = self.bottom.simd_ge(k(tile)) & low.simd_le(high) & left.simd_le(right);
            let edges: [i32x16<S>; 2] =
                each!(2, n => ([left, right + k(EDGE)][n] * k(INVERSE_EDGE)).to_int());
            let [first, end]: [u32x16<S>; 2] = each!(2, n => edges[n].bitcast());
            out.set(row, hit, first, end);
        }
        out
    }
}
