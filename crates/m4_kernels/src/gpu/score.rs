//! The scores of density control: splats in regions where the image is wrong (Minute4D Eq. 9, Minute4D Eq. 10).
//!
//! Views add up on the device; one read ends it.

use crate::View;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::error_mask::Mask;
use crate::gpu::found::{LOSSES, StepSums};
use crate::gpu::trainer::TRAINING;
use crate::gpu::{GpuError, Trainer};
use crate::score::gpu::{FrameScore, add};
use crate::tile_binning::gpu as tile_binning;

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
            let frame = FrameScore {
                errors: &mask.errors,
                cut: &mask.cut,
                tally: &tally.buffer,
                loss: LOSSES + look,
                share,
            };
            add(&gpu, &self.work, &self.splats, &frame, &scores);
        }
        Ok(scores)
    }
}
