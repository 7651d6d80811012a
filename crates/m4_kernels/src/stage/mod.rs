//! Slice, project and shade in one pass over the columns, forward and backward.
//!
//! Rows are cut into fixed chunks, static and dynamic rows apart; a chunk is a task. Forward, it
//! hands every splat on once, as a [`Row`], and tells each band which of them reach it. Backward,
//! it collects the moments of its splats from the bands, in the order of the bands, and turns them
//! into gradients of the columns.
//!
//! Sixteen rows are a group. Splats of a group go to their bands one band after the other, not one
//! splat after the other: neighbours in memory are neighbours in the image, so a group reaches few
//! bands, and the length of the loops is guessed right far more often.

#[cfg(feature = "gpu")]
pub(crate) mod gpu;
mod passes;

use crate::{
    blend::cpu::Sums,
    project::cpu::Eye,
    simd::LANES,
    slice::cpu::Columns,
    tile_binning::handover::{Handover, Row},
};
use fearless_simd::Simd;
use m4_core::Splats;
use std::ops::Range;

/// Rows a chunk: enough to make the task worth it, few enough to share the work evenly.
const CHUNK_ROWS: usize = 2048;

/// Sixteen rows of which at least one is seen.
#[derive(Debug, Clone, Copy)]
struct Group {
    /// From the first row of the chunk.
    at: u32,
    /// Lanes that reach a tile.
    lanes: u16,
    /// Where the group's entries of [`Chunk::parts`] end; they start where those of the one before
    /// end.
    parts_end: u32,
}

/// The splats of a group that one band got.
#[derive(Debug, Clone, Copy)]
struct BandLanes {
    band: u16,
    lanes: u16,
}

/// One chunk of rows and what it showed in the last frame.
#[derive(Debug, Default)]
pub(crate) struct Chunk {
    pub(crate) rows: Range<usize>,
    pub(crate) dynamic: bool,
    /// Where its projected splats start among all.
    place: usize,
    /// The splats that reach each band, in the order of the rows.
    pub(crate) bands: Vec<Handover>,
    groups: Vec<Group>,
    parts: Vec<BandLanes>,
    /// Temporal marginals of each group; empty for static rows, where they are 1.
    marginals: Vec<[f32; LANES]>,
}

/// One chunk's rows of [`crate::Gradients`].
#[derive(Debug)]
pub(crate) struct ChunkGradient<'a> {
    pub(crate) columns: Vec<&'a mut [f32]>,
    pub(crate) touched: &'a mut [u8],
    /// Empty unless asked for.
    pub(crate) image: &'a mut [f32],
}

/// One chunk's share of the camera's gradient: `tau`, `omega`, `fx, fy, cx, cy`.
pub(crate) type CameraSums = [f64; 10];

impl Chunk {
    /// Cuts rows into chunks, keeping the memory of those that were there.
    pub(crate) fn plan(chunks: &mut Vec<Self>, splats: &Splats, bands: usize) {
        let (bound, n) = (splats.bound(), splats.n());
        let cut = |rows: Range<usize>, dynamic: bool| {
            rows.clone()
                .step_by(CHUNK_ROWS)
                .map(move |start| (start..rows.end.min(start + CHUNK_ROWS), dynamic))
        };
        let plan = cut(0..bound.start, false)
            .chain(cut(bound.clone(), false))
            .chain(cut(bound.end..n, true));
        let (mut count, mut place) = (0, 0);
        for (rows, dynamic) in plan {
            if chunks.len() == count {
                chunks.push(Self::default());
            }
            let chunk = &mut chunks[count];
            (chunk.rows, chunk.dynamic, chunk.place) = (rows, dynamic, place);
            place += chunk.room();
            chunk.bands.resize_with(bands, Handover::default);
            count += 1;
        }
        chunks.truncate(count);
    }

    /// Rows that it writes, whole groups.
    pub(crate) fn room(&self) -> usize {
        self.rows.len().next_multiple_of(LANES)
    }

    /// Splats that reach the image.
    pub(crate) fn visible(&self) -> usize {
        self.groups
            .iter()
            .map(|g| g.lanes.count_ones() as usize)
            .sum()
    }

    /// Fills `bands` and, for groups that are seen, `out`, which is [`room`](Self::room) long.
    #[inline(always)]
    pub(crate) fn forward<S: Simd>(&mut self, s: S, c: &Columns<'_>, eye: &Eye, out: &mut [Row]) {
        match (self.dynamic, c.layout.isotropic) {
            (false, false) => passes::chunk_forward::<S, false, false>(s, self, c, eye, out),
            (false, true) => passes::chunk_forward::<S, false, true>(s, self, c, eye, out),
            (true, false) => passes::chunk_forward::<S, true, false>(s, self, c, eye, out),
            (true, true) => passes::chunk_forward::<S, true, true>(s, self, c, eye, out),
        }
    }

    /// Fills the chunk's part of the gradients; `sums[band]` starts at this chunk's first record.
    #[inline(always)]
    pub(crate) fn backward<S: Simd>(
        &self,
        s: S,
        c: &Columns<'_>,
        eye: &Eye,
        sums: &mut [&[Sums]],
        with_camera: bool,
        out: &mut ChunkGradient<'_>,
    ) -> CameraSums {
        out.touched.fill(0);
        match (self.dynamic, c.layout.isotropic) {
            (false, false) => {
                passes::chunk_backward::<S, false, false>(s, self, c, eye, sums, with_camera, out)
            }
            (false, true) => {
                passes::chunk_backward::<S, false, true>(s, self, c, eye, sums, with_camera, out)
            }
            (true, false) => {
                passes::chunk_backward::<S, true, false>(s, self, c, eye, sums, with_camera, out)
            }
            (true, true) => {
                passes::chunk_backward::<S, true, true>(s, self, c, eye, sums, with_camera, out)
            }
        }
    }

    /// Adds marginal times score to the chunk's rows; `scores[band]` starts at its first record.
    pub(crate) fn score(&self, scores: &mut [&[f32]], out: &mut [f32]) {
        let mut from = 0;
        for (index, group) in self.groups.iter().enumerate() {
            let mut sums = [0.0f32; LANES];
            for part in &self.parts[from..group.parts_end as usize] {
                let band = &mut scores[usize::from(part.band)];
                let (first, rest) = band.split_at(part.lanes.count_ones() as usize);
                for (lane, score) in crate::simd::lanes(part.lanes).zip(first) {
                    sums[lane] += score;
                }
                *band = rest;
            }
            from = group.parts_end as usize;
            let marginals = self.marginals.get(index).unwrap_or(&[1.0; LANES]);
            for lane in crate::simd::lanes(group.lanes) {
                out[group.at as usize + lane] += marginals[lane] * sums[lane];
            }
        }
    }
}
