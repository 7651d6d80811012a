//! The scores of one frame (Minute4D Eq. 9, Minute4D Eq. 10): sums of the errors over the pixels
//! that each splat is blended on (a slot per tile and splat, as in the backward pass), times the
//! temporal marginal of the splat at that instant, which is 1 for static and bound splats.

use crate::gpu::Gpu;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::vector::TIME;
use crate::launch;
use crate::renderer::gpu::Work;
use crate::slice::gpu::{carried, life};
use crate::splats::DeviceSplats;
use crate::tile_binning::gpu::{BUCKETS, RECORD};
use cubecl::prelude::*;

const LOG2_ALPHA_MIN: f32 = crate::ellipse::LOG2_ALPHA_MIN as f32;

/// The errors of a frame and their weights.
#[derive(Debug, Clone, Copy)]
pub struct FrameScore<'a> {
    /// Error of each pixel.
    pub errors: &'a Buffer,
    /// Errors above the first number count; none where the second is 0.
    pub cut: &'a Buffer,
    /// Holds the loss of the frame as the bits of a float,
    pub tally: &'a Buffer,
    /// here.
    pub loss: usize,
    /// Weight of the frame in the first score.
    pub share: f32,
}

/// Adds the scores of the frame that `work` drew last to `scores`, `[2][n]`: errors times `share`,
/// errors times loss.
pub fn add(gpu: &Gpu, work: &Work, splats: &DeviceSplats, frame: &FrameScore<'_>, scores: &Buffer) {
    let (client, n) = (&gpu.client, splats.n);
    let (count, dim) = work.cubes_of_buckets();
    launch!(
        client,
        score_slots::launch,
        (count, dim),
        [
            work.records,
            work.splat_of_entry,
            work.slot_of_entry(),
            work.ranges,
            work.tile_of_bucket,
            work.bucket_offsets,
            work.totals,
            work.ends,
            frame.errors,
            frame.cut,
            work.sums
        ],
        [work.size.width as u32, work.size.height as u32]
    );
    launch!(
        client,
        score_splats::launch,
        (cubes(n, 256), units()),
        [
            splats.geometry,
            splats.time,
            splats.posed(&work.eye),
            work.eye,
            work.counts,
            work.offsets,
            work.sums,
            frame.tally,
            scores
        ],
        [
            n as u32,
            splats.n_static as u32,
            splats.n_still() as u32,
            frame.loss as u32,
            frame.share,
            splats.n_still() > splats.n_static
        ]
    );
}

/// The errors that count (Minute4D Eq. 8), summed over the pixels of a tile that a splat is blended
/// on: a cube a bucket, a unit an entry.
#[cube(launch)]
fn score_slots(
    records: &[f32],
    splats: &[u32],
    slots: &[u32],
    ranges: &[u32],
    tile_of: &[u32],
    offsets: &[u32],
    totals: &[u32],
    ends: &[u32],
    errors: &[f32],
    cut: &[f32],
    sums: &mut [f32],
    width: u32,
    height: u32,
) {
    let mut weights = Shared::<[f32]>::new_slice(64usize);
    let mut lasts = Shared::<[u32]>::new_slice(64usize);
    let bucket = CUBE_POS as u32;
    if bucket < totals[BUCKETS] {
        let tile = tile_of[bucket as usize];
        let start = ranges[(2u32 * tile) as usize];
        let entry = start + (bucket - offsets[tile as usize]) * 32u32 + UNIT_POS;
        let across = (width + 7u32) / 8u32;
        let (left, top) = ((tile % across) * 8u32, (tile / across) * 8u32);
        let mut p = UNIT_POS;
        while p < 64u32 {
            let (x, y) = (left + p % 8u32, top + p / 8u32);
            let mut weight = 0.0f32;
            let mut last = 0u32;
            if x < width && y < height {
                let at = (y * width + x) as usize;
                last = ends[at];
                let error = errors[at];
                if cut[1] > 0.0f32 && error > cut[0] {
                    weight = error;
                }
            }
            weights[p as usize] = weight;
            lasts[p as usize] = last;
            p += 32u32;
        }
        sync_cube();
        if entry < ranges[(2u32 * tile + 1u32) as usize] {
            let r = splats[entry as usize] as usize * RECORD;
            let (u, v) = (records[r], records[r + 1]);
            let (a, b, c) = (records[r + 2], records[r + 3], records[r + 4]);
            let log_opacity = records[r + 5];
            let mut sum = 0.0f32;
            for p in 0u32..64u32 {
                let dx = u - f32::cast_from(left + p % 8u32);
                let dy = v - f32::cast_from(top + p / 8u32);
                let power = a * dx * dx + b * dx * dy + c * dy * dy;
                let exponent = log_opacity - power;
                if entry < lasts[p as usize] && power >= 0.0f32 && exponent >= LOG2_ALPHA_MIN {
                    sum += weights[p as usize];
                }
            }
            sums[slots[entry as usize] as usize] = sum;
        }
    }
}

/// Adds up each splat's slots in their order; `scores` are `[2][n]`.
#[cube(launch)]
fn score_splats(
    geometry: &[f32],
    time: &[f32],
    posed: &[f32],
    eye: &[f32],
    counts: &[u32],
    offsets: &[u32],
    sums: &[f32],
    tally: &[u32],
    scores: &mut [f32],
    n: u32,
    n_static: u32,
    n_still: u32,
    loss_at: u32,
    share: f32,
    #[comptime] bound: bool,
) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        let count = counts[i as usize];
        if count > 0u32 {
            let mut sum = 0.0f32;
            for k in 0u32..count {
                sum += sums[(offsets[i as usize] + k) as usize];
            }
            let carried = carried(i, n_static, n_still);
            let life = life(
                geometry, time, posed, &carried, i, n, n_static, n_still, eye[TIME], bound,
            );
            let score = sum * life.marginal;
            let loss = f32::reinterpret(tally[loss_at as usize]);
            scores[i as usize] += score * share;
            scores[(n + i) as usize] += score * loss;
        }
    }
}
