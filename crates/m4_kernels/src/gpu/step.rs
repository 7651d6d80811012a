//! Whole training steps on the device.

use crate::adam::gpu as adam;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::splats::parts;
use crate::gpu::{GpuError, Trainer};
use crate::{View, adam::cpu::AdamConfig};
use m4_core::ShapeError;

/// What a step depends on besides splats and frame.
#[derive(Debug, Clone, Copy)]
pub struct StepSettings<'a> {
    /// Share of SSIM in the loss, 0..=1.
    pub lambda_ssim: f32,
    /// One learning rate a column of the splats.
    pub rates: &'a [f32],
    /// The optimiser.
    pub adam: AdamConfig,
}

/// A frame of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look<'a> {
    /// Its number.
    pub frame: usize,
    /// The view that it is rendered with.
    pub view: &'a View,
    /// Also take the gradient of the camera, for [`Found::cameras`](crate::gpu::Found::cameras).
    pub camera: bool,
    /// Also take the gradient of the frame's [exposure](Trainer::set_exposures), for
    /// [`Found::exposures`](crate::gpu::Found::exposures); nothing for a frame without.
    pub exposure: bool,
}

impl<'a> Look<'a> {
    /// The photometric loss alone.
    #[must_use]
    pub fn new(frame: usize, view: &'a View) -> Self {
        Self {
            frame,
            view,
            camera: false,
            exposure: false,
        }
    }
}

impl Trainer {
    /// Draws `view`, compares it with frame `frame`, and moves every splat that was seen. Returns before the device is
    /// done; nothing is read back but, in the first step after splats were replaced, how many tile entries there are.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if there is no such frame, if the view has another size, if there is no room for the tile entries, or if the device failed.
    pub fn step(&mut self, frame: usize, view: &View, settings: &StepSettings<'_>) -> Result<(), GpuError> {
        self.step_looks(&[Look::new(frame, view)], settings)
    }

    /// One step along the sum of the gradients of some frames, as [`step`](Self::step) is of one; nothing for none.
    ///
    /// # Errors
    ///
    /// As [`step`](Self::step).
    pub fn step_looks(&mut self, looks: &[Look<'_>], settings: &StepSettings<'_>) -> Result<(), GpuError> {
        let columns = self.splats.layout.columns();
        ShapeError::check("learning rates", columns, settings.rates.len())?;
        for (k, look) in looks.iter().enumerate() {
            if k == 1 {
                self.start_sum();
            }
            self.look(look, settings.lambda_ssim)?;
            if k > 0 {
                self.add_to_sum();
            }
        }
        if looks.len() > 1 {
            self.swap_sum();
        }
        if !looks.is_empty() {
            self.move_splats(settings);
        }
        Ok(())
    }

    /// Draws, compares, and leaves the gradients of the splats.
    fn look(&mut self, look: &Look<'_>, lambda: f32) -> Result<(), GpuError> {
        let target = self.frames.get(&self.gpu, look.frame)?;
        self.draw(&View {
            with_depth: false,
            ..*look.view
        })?;
        let (shown, exposure) = self.corrected(look.frame);
        let (gpu, gradient) = (&self.gpu, &self.work.gradient);
        self.loss.compare(gpu, &shown, &target, 0, lambda, &self.tally);
        self.loss.gradient(gpu, &shown, &target, lambda, gradient);
        if let Some(exposure) = exposure {
            self.pull_back(look.frame, &exposure, look.exposure);
        }
        let gpu = &self.gpu;
        let camera = look.camera.then(|| self.cameras.next(gpu, look.frame, self.splats.n));
        self.work.backward(
            gpu,
            &self.splats,
            &self.gradients,
            look.view.mip,
            false,
            false,
            camera.as_ref(),
        );
        if look.camera {
            self.cameras.add_up(gpu);
        }
        Ok(())
    }

    fn move_splats(&self, settings: &StepSettings<'_>) {
        let client = &self.gpu.client;
        let (n, n_static) = (self.splats.n, self.splats.n_static);
        self.tally.step(&self.gpu, &self.work.touched, n);
        let sparse = settings.adam.sparse;
        adam::count_steps::launch(
            client,
            cubes(n, 256),
            units(),
            self.work.touched.arg(),
            self.steps.arg(),
            n as u32,
            sparse,
        );
        let groups = [
            (
                &self.splats.geometry,
                &self.gradients.geometry,
                &self.m.geometry,
                &self.v.geometry,
                0,
                n,
            ),
            (
                &self.splats.colour,
                &self.gradients.colour,
                &self.m.colour,
                &self.v.colour,
                0,
                n,
            ),
            (
                &self.splats.time,
                &self.gradients.time,
                &self.m.time,
                &self.v.time,
                n_static,
                n - n_static,
            ),
        ];
        for ((x, g, m, v, first, rows), columns) in groups.into_iter().zip(parts(self.splats.layout)) {
            if rows == 0 {
                continue;
            }
            let count = columns.len() as u32;
            let rates = Buffer::floats(client, &settings.rates[columns]);
            adam::adam::launch(
                client,
                cubes(rows, 256),
                units(),
                x.arg(),
                g.arg(),
                m.arg(),
                v.arg(),
                self.work.touched.arg(),
                self.steps.arg(),
                rates.arg(),
                self.tally.buffer.arg(),
                rows as u32,
                first as u32,
                n_static as u32,
                count,
                settings.adam.beta1 as f32,
                settings.adam.beta2 as f32,
                settings.adam.beta2_dynamic as f32,
                settings.adam.eps as f32,
                sparse,
            );
        }
    }
}
