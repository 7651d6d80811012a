//! The scores of density control: splats in regions where the image is wrong (Minute4D Eq. 9, Minute4D Eq. 10).
//!
//! For each look: errors of the pixels, those above a threshold of the frame's own range, sums of them over the pixels
//! that each splat is blended on (a slot per tile and splat, as in the backward pass), times how much of the splat is there
//! at that instant. Looks add up on the device; one read ends it.

use crate::buffer::{Buffer, cubes, units};
use crate::error_mask::Mask;
use crate::eye::TIME;
use crate::found::{LOSSES, StepSums};
use crate::slice::life;
use crate::trainer::TRAINING;
use crate::{GpuError, Trainer, tile_binning};
use cubecl::prelude::*;
use m4_kernels::View;

/// Which errors of a frame count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoreSettings {
    /// Share of SSIM in the loss that weighs a frame for pruning, 0..=1.
    pub lambda_ssim: f32,
    /// Errors above this share of the frame's range count, 0..1.
    pub threshold: f32,
    /// What the range of a frame is.
    pub range: ScoreRange,
}

/// What the range of a frame's errors is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ScoreRange {
    /// From its smallest to its largest error.
    MinMax,
    /// From 0 to the error below which a share `high` of its pixels lies.
    Quantile {
        /// 0..=1.
        high: f32,
    },
}

/// Two numbers per splat, `[n]` each.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ScoreSums {
    /// Mean over the looks of the errors where the splat is.
    pub densify: Vec<f32>,
    /// Their sum, each look weighted by its loss.
    pub prune: Vec<f32>,
}

impl Trainer {
    /// Draws each look, frame by number and how it is seen, and adds up what is wrong where the splats are.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if there is no such frame, if there is no room for the tile entries, or if the device failed.
    pub fn score(&mut self, looks: &[(usize, View)], settings: &ScoreSettings) -> Result<ScoreSums, GpuError> {
        let n = self.splats.n;
        let scores = self.scores(looks, settings)?;
        let mut both = scores.read_floats(&self.gpu.client, TRAINING)?;
        both.truncate(2 * n);
        let prune = both.split_off(n);
        Ok(ScoreSums { densify: both, prune })
    }

    /// [`score`](Self::score), left on the device: `[2][n]`.
    pub(crate) fn scores(&mut self, looks: &[(usize, View)], settings: &ScoreSettings) -> Result<Buffer, GpuError> {
        let n = self.splats.n;
        let gpu = self.gpu.clone();
        let tally = StepSums::new(&gpu, looks.len(), 0);
        let scores = Buffer::empty(&gpu.client, 2 * n);
        tile_binning::clear::launch(&gpu.client, cubes(2 * n, 256), units(), scores.arg());
        let mask = Mask::new(&gpu, self.work.size.pixels(), settings.range);
        let share = 1.0 / looks.len().max(1) as f32;
        for (look, (frame, view)) in looks.iter().enumerate() {
            self.draw(view)?;
            let target = self.frames.get(&gpu, *frame)?;
            let (shown, _) = self.corrected(*frame);
            self.loss
                .compare(&gpu, &shown, &target, look, settings.lambda_ssim, &tally);
            mask.find(&gpu, &shown, &target, settings.threshold);
            self.add_scores(&mask, &tally, look, share, &scores);
        }
        Ok(scores)
    }

    fn add_scores(&self, mask: &Mask, tally: &StepSums, look: usize, share: f32, scores: &Buffer) {
        let (client, work, n) = (&self.gpu.client, &self.work, self.splats.n);
        let (count, dim) = work.cubes_of_buckets();
        score_slots::launch(
            client,
            count,
            dim,
            work.records.arg(),
            work.splat_of_entry.arg(),
            work.slots().arg(),
            work.ranges.arg(),
            work.tile_of_bucket.arg(),
            work.bucket_offsets.arg(),
            work.buckets().arg(),
            work.ends.arg(),
            mask.errors.arg(),
            mask.cut.arg(),
            work.sums.arg(),
            work.size.width as u32,
            work.size.height as u32,
        );
        score_splats::launch(
            client,
            cubes(n, 256),
            units(),
            self.splats.geometry.arg(),
            self.splats.time.arg(),
            work.eye.arg(),
            work.depth.values.arg(),
            work.sorted_counts.arg(),
            work.offsets.arg(),
            work.sums.arg(),
            tally.buffer.arg(),
            scores.arg(),
            n as u32,
            self.splats.n_static as u32,
            look as u32,
            share,
        );
    }
}

/// The errors that count (Minute4D Eq. 8), summed over the pixels of a tile that a splat is blended on: a cube a bucket, a unit an entry.
#[cube(launch)]
fn score_slots(
    records: &[f32],
    splats: &[u32],
    slots: &[u32],
    ranges: &[u32],
    tile_of: &[u32],
    offsets: &[u32],
    bucket_count: &[u32],
    ends: &[u32],
    errors: &[f32],
    cut: &[f32],
    sums: &mut [f32],
    width: u32,
    height: u32,
) {
    let mut weights = Shared::<[f32]>::new_slice(256usize);
    let mut lasts = Shared::<[u32]>::new_slice(256usize);
    let bucket = CUBE_POS as u32;
    if bucket < bucket_count[0] {
        let tile = tile_of[bucket as usize];
        let start = ranges[(2u32 * tile) as usize];
        let entry = start + (bucket - offsets[tile as usize]) * 32u32 + UNIT_POS;
        let across = (width + 15u32) / 16u32;
        let (left, top) = ((tile % across) * 16u32, (tile / across) * 16u32);
        let mut p = UNIT_POS;
        while p < 256u32 {
            let (x, y) = (left + p % 16u32, top + p / 16u32);
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
            let r = splats[entry as usize] as usize * 10;
            let (u, v) = (records[r], records[r + 1]);
            let (a, b, c) = (records[r + 2], records[r + 3], records[r + 4]);
            let log_opacity = records[r + 5];
            let mut sum = 0.0f32;
            for p in 0u32..256u32 {
                let dx = u - f32::cast_from(left + p % 16u32);
                let dy = v - f32::cast_from(top + p / 16u32);
                let power = a * dx * dx + b * dx * dy + c * dy * dy;
                let exponent = log_opacity - power;
                if entry < lasts[p as usize] && power >= 0.0f32 && exponent >= -7.994_353_4f32 {
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
    eye: &[f32],
    order: &[u32],
    counts: &[u32],
    offsets: &[u32],
    sums: &[f32],
    tally: &[u32],
    scores: &mut [f32],
    n: u32,
    n_static: u32,
    look: u32,
    share: f32,
) {
    let p = ABSOLUTE_POS as u32;
    if p < n {
        let count = counts[p as usize];
        if count > 0u32 {
            let i = order[p as usize];
            let mut sum = 0.0f32;
            for k in 0u32..count {
                sum += sums[(offsets[p as usize] + k) as usize];
            }
            let life = life(geometry, time, i, n, n_static, eye[TIME]);
            let score = sum * life.marginal;
            let loss = f32::reinterpret(tally[LOSSES + look as usize]);
            scores[i as usize] += score * share;
            scores[(n + i) as usize] += score * loss;
        }
    }
}
