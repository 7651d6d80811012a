//! Whole training steps on the device, with the gradients of several frames added up.

use crate::backend::{StepSettings, StepView, gpu::GpuTrainer, pixels};
use cubecl::prelude::*;
use m4_core::ShapeError;
use m4_kernels::launch;
use m4_kernels::{
    View,
    adam::gpu::step,
    cover,
    gpu::{
        Gpu, GpuError,
        buffer::{Buffer, cubes, units},
    },
    splats::{DeviceSplats, parts},
};

/// The sum so far, or, while the trainer's own memory holds that, the memory of the next frame.
#[derive(Debug)]
pub(crate) struct Batch {
    gradients: DeviceSplats,
    touched: Buffer,
}

impl Batch {
    fn new(gpu: &Gpu, splats: &DeviceSplats) -> Self {
        Self {
            gradients: splats.like(gpu),
            touched: Buffer::empty(&gpu.client, splats.n),
        }
    }
}

impl GpuTrainer {
    /// What the first frame left becomes the sum.
    pub(crate) fn start_sum(&mut self) {
        let shape = |splats: &DeviceSplats| (splats.n, splats.n_static, splats.layout);
        if !self
            .batch
            .as_ref()
            .is_some_and(|b| shape(&b.gradients) == shape(&self.splats))
        {
            self.batch = Some(Batch::new(&self.gpu, &self.splats));
        }
        self.swap_sum();
    }

    /// Exchanges the sum with what the last frame left.
    pub(crate) fn swap_sum(&mut self) {
        if let Some(batch) = &mut self.batch {
            std::mem::swap(&mut batch.gradients, &mut self.gradients);
            std::mem::swap(&mut batch.touched, &mut self.work.touched);
        }
    }

    /// Adds what the last frame left.
    pub(crate) fn add_to_sum(&self) {
        let Some(batch) = &self.batch else { return };
        let (client, n, n_static) = (&self.gpu.client, self.splats.n, self.splats.n_static);
        let (sum, more) = (&batch.gradients, &self.gradients);
        for (k, columns) in parts(self.splats.layout).into_iter().enumerate() {
            let [sum, more] = [sum, more].map(|s| s.buffers()[k]);
            let first = if k == 2 { n_static } else { 0 };
            let rows = n - first;
            if rows == 0 {
                continue;
            }
            launch!(
                client,
                add_touched::launch,
                (cubes(rows, 256), units()),
                [sum, more, batch.touched, self.work.touched],
                [rows as u32, first as u32, columns.len() as u32]
            );
        }
        launch!(
            client,
            unite::launch,
            (cubes(n, 256), units()),
            [batch.touched, self.work.touched],
            [n as u32]
        );
    }
}

/// Adds the rows that `new` names; rows that neither names hold anything.
#[cube(launch)]
fn add_touched(
    sum: &mut [f32],
    more: &[f32],
    old: &[u32],
    new: &[u32],
    rows: u32,
    first: u32,
    #[comptime] columns: u32,
) {
    let i = ABSOLUTE_POS as u32;
    if i < rows {
        let splat = (first + i) as usize;
        if new[splat] != 0u32 {
            let has_old = old[splat] != 0u32;
            for c in 0u32..columns {
                let at = (c * rows + i) as usize;
                let mut value = more[at];
                if has_old {
                    value += sum[at];
                }
                sum[at] = value;
            }
        }
    }
}

#[cube(launch)]
fn unite(old: &mut [u32], new: &[u32], n: u32) {
    let i = ABSOLUTE_POS;
    if i < n as usize {
        old[i] |= new[i];
    }
}

impl GpuTrainer {
    /// Renders each view, compares it with its frame, and moves every splat that was seen along the
    /// sum of the gradients; nothing for no view. Returns before the device is done; nothing is
    /// read back but, in the first step after splats were replaced, how many tile entries there
    /// are. Fails with [`GpuError`] if there is no such frame, if a view has another size, if there
    /// is no room for the tile entries, or if the device failed.
    pub fn step(
        &mut self,
        views: &[StepView<'_>],
        settings: &StepSettings<'_>,
    ) -> Result<(), GpuError> {
        let columns = self.splats.layout.columns();
        ShapeError::check("learning rates", columns, settings.rates.len())?;
        self.work.node_keys.clear();
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
        self.draw(&View {
            with_depth: false,
            ..*step.view
        })?;
        let (shown, exposure) = self.corrected(step.frame);
        let (gpu, gradient) = (&self.gpu, &self.work.gradient);
        self.loss
            .differentiate(gpu, &shown, &target, lambda, &self.tally, gradient);
        if let Some(exposure) = exposure {
            self.pull_back(step.frame, &exposure, step.exposure);
        }
        let (gpu, n) = (&self.gpu, self.splats.n);
        let camera = step.camera.then(|| self.cameras.next(gpu, step.frame, n));
        let centres = self
            .image_gradients
            .as_mut()
            .map(|sums| sums.centres(gpu, n));
        self.work.backward(
            gpu,
            &self.splats,
            &self.gradients,
            step.view.mip,
            camera.as_ref(),
            centres,
        );
        if step.camera {
            self.cameras.add_up(gpu);
        }
        if let Some(sums) = &self.image_gradients {
            sums.add(gpu, &self.work, &self.adam);
        }
        Ok(())
    }

    /// Moves every splat that was seen, and the nodes that carry them; `weight` is that of
    /// [`cover`].
    fn move_splats(&self, settings: &StepSettings<'_>, weight: f32) {
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
        if let Some(bound) = &self.splats.bound {
            let (nodes, keys) = (&self.adam.nodes, &self.work.node_keys);
            nodes.step(
                &self.gpu,
                bound,
                keys,
                &self.tally,
                &settings.adam,
                settings.nodes,
            );
        }
    }
}
