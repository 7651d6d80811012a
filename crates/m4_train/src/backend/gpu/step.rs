//! Whole training steps on the device.

use super::GpuTrainer;
use crate::backend::{StepSettings, StepView, pixels};
use m4_core::ShapeError;
use m4_kernels::{View, adam::gpu::step, cover, gpu::GpuError};

impl GpuTrainer {
    /// Renders each view, compares it with its frame, and moves every splat that was seen along the sum of the gradients; nothing for no
    /// view. Returns before the device is done; nothing is read back but, in the first step after splats were replaced, how many
    /// tile entries there are.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if there is no such frame, if a view has another size, if there is no room for the tile entries, or if the device failed.
    pub fn step(&mut self, views: &[StepView<'_>], settings: &StepSettings<'_>) -> Result<(), GpuError> {
        let columns = self.splats.layout.columns();
        ShapeError::check("learning rates", columns, settings.rates.len())?;
        for (k, view) in views.iter().enumerate() {
            if k == 1 {
                self.start_sum();
            }
            self.frame_gradient(view, settings.lambda_ssim)?;
            if k > 0 {
                self.add_to_sum();
            }
        }
        if views.len() > 1 {
            self.swap_sum();
        }
        if let Some(first) = views.first() {
            self.move_splats(settings, settings.cover / pixels(first.view));
        }
        Ok(())
    }

    /// Renders a frame, compares it, and leaves the gradients of the splats.
    fn frame_gradient(&mut self, step: &StepView<'_>, lambda: f32) -> Result<(), GpuError> {
        let target = self.frames.get(&self.gpu, step.frame)?;
        self.draw(&View { with_depth: false, ..*step.view })?;
        let (shown, exposure) = self.corrected(step.frame);
        let (gpu, gradient) = (&self.gpu, &self.work.gradient);
        self.loss.compare(gpu, &shown, &target, 0, lambda, &self.tally);
        self.loss.gradient(gpu, &shown, &target, lambda, gradient);
        if let Some(exposure) = exposure {
            self.pull_back(step.frame, &exposure, step.exposure);
        }
        let gpu = &self.gpu;
        let camera = step.camera.then(|| self.cameras.next(gpu, step.frame, self.splats.n));
        self.work.backward(gpu, &self.splats, &self.gradients, step.view.mip, false, false, camera.as_ref());
        if step.camera {
            self.cameras.add_up(gpu);
        }
        Ok(())
    }

    /// Moves every splat that was seen; `weight` is that of [`cover`].
    fn move_splats(&self, settings: &StepSettings<'_>, weight: f32) {
        self.tally.step(&self.gpu, &self.work.touched, self.splats.n);
        if weight > 0.0 {
            let (splats, gradients) = (&self.splats, &self.gradients);
            cover::gpu::add(&self.gpu, splats, gradients, &self.work.touched, weight);
        }
        step(
            &self.gpu,
            &self.splats,
            &self.gradients,
            &self.work.touched,
            &self.adam,
            &self.tally,
            &settings.adam,
            settings.rates,
        );
    }
}
