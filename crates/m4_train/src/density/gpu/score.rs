//! The scores of density control: splats in regions where the image is wrong; [`add`] defines those of a frame.
//!
//! Views add up on the device; one read ends it.

use super::error_mask::Mask;
use crate::backend::ScoreSettings;
use crate::backend::gpu::{GpuTrainer, TRAINING};
use crate::density::Scores;
use m4_kernels::View;
use m4_kernels::gpu::GpuError;
use m4_kernels::gpu::buffer::Buffer;
use m4_kernels::gpu::tally::{LOSSES, Tally};
use m4_kernels::score::gpu::{FrameScore, add};

impl GpuTrainer {
    /// Renders each view of a frame, by its number, and adds up the errors on the footprints of the splats.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if there is no such frame, if there is no room for the tile entries, or if the device failed.
    pub fn score(&mut self, views: &[(usize, View)], settings: &ScoreSettings) -> Result<Scores, GpuError> {
        let n = self.splats.n;
        let scores = self.scores(views, settings)?;
        let mut both = scores.read_floats(&self.gpu.client, TRAINING)?;
        both.truncate(2 * n);
        let prune = both.split_off(n);
        Ok(Scores { densify: both, prune })
    }

    /// [`score`](Self::score), left on the device: `[2][n]`.
    pub(crate) fn scores(&mut self, views: &[(usize, View)], settings: &ScoreSettings) -> Result<Buffer, GpuError> {
        let n = self.splats.n;
        let gpu = self.gpu.clone();
        let tally = Tally::new(&gpu, views.len(), 0);
        let scores = Buffer::zeros(&gpu.client, 2 * n);
        let mask = Mask::new(&gpu, self.work.size.pixels(), settings.range);
        let share = 1.0 / views.len().max(1) as f32;
        for (index, (frame, view)) in views.iter().enumerate() {
            self.draw(view)?;
            let target = self.frames.get(&gpu, *frame)?;
            let (shown, _) = self.corrected(*frame);
            self.loss.compare(&gpu, &shown, &target, index, settings.lambda_ssim, &tally);
            mask.find(&gpu, &shown, &target, settings.threshold);
            let frame =
                FrameScore { errors: &mask.errors, cut: &mask.cut, tally: &tally.buffer, loss: LOSSES + index, share };
            add(&gpu, &self.work, &self.splats, &frame, &scores);
        }
        Ok(scores)
    }
}
