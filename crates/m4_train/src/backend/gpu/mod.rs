//! Training steps on a GPU.

mod bench;
mod density;
mod exposure;
mod phase;
mod sum;
mod trainer;

pub use bench::{Bench, Drawing};
use phase::move_phases;
pub use trainer::GpuTrainer;

use super::{Backend, BackendError, ColourSums, StepSettings, StepView};
use crate::density::{DensityRound, DensityStats};
use crate::{ColourDegree, TrainConfig};
use m4_core::{Exposure, Splats};
use m4_kernels::adam::cpu::AdamState;
use m4_kernels::gpu::{Gpu, GpuError};
use m4_kernels::loss::cpu::Target;
use m4_kernels::plan::Plan;
use m4_kernels::renderer::gpu::Size;
use m4_kernels::{StepStats, View};

/// Entries of tiles that a static splat usually has.
const ENTRIES: usize = 4;

/// A GPU that trains.
#[derive(Debug)]
pub struct GpuBackend {
    gpu: Gpu,
    /// Most memory that it may take; all that there is for `None`.
    limit_bytes: Option<u64>,
    /// Steps have several frames.
    batches: bool,
    /// Density control goes by gradients in the image.
    image_gradients: bool,
    /// Those that memory is planned for.
    degree: ColourDegree,
    /// Frames that wait for the first splats.
    waiting: Vec<Target>,
    trainer: Option<GpuTrainer>,
}

impl GpuBackend {
    /// Training by `config` on `gpu`, within `max_vram_mb`.
    pub fn new(gpu: Gpu, max_vram_mb: Option<usize>, config: &TrainConfig) -> Self {
        Self {
            gpu,
            limit_bytes: max_vram_mb.map(|mb| mb as u64 * 1_000_000),
            batches: config.batch > 1,
            image_gradients: false,
            degree: config.colour_degree,
            waiting: Vec::new(),
            trainer: None,
        }
    }

    fn trainer(&mut self) -> Result<&mut GpuTrainer, BackendError> {
        self.trainer.as_mut().ok_or_else(|| {
            BackendError("the GPU was asked to work before it had splats".to_owned())
        })
    }

    /// Bytes for frames on the device, those that fit beside everything else. The others are sent
    /// when they are used.
    fn budget(&self, splats: &Splats, frames: &[Target]) -> Result<usize, GpuError> {
        let size = frames.first().map_or((0, 0), |f| (f.width(), f.height()));
        let layout = self.degree.raise(splats.layout());
        let plan = |frames, entries| {
            let plan = Plan::training(
                splats.n_static(),
                splats.n_dynamic(),
                layout,
                size,
                frames,
                entries,
            );
            let plan = plan.with_bound(splats.bindings().len(), splats.windows());
            let plan = if self.batches {
                plan.with_batches()
            } else {
                plan
            };
            if self.image_gradients {
                plan.with_image_gradients()
            } else {
                plan
            }
        };
        let entries = Size::first_entries(splats.n());
        let least = plan(1, entries);
        least.check_buffers(&self.gpu)?;
        let Some(limit) = self.limit_bytes else {
            return Ok(usize::MAX);
        };
        least.check(limit)?;
        // frames leave room for as many entries as images usually have
        let all = plan(frames.len(), entries + ENTRIES * splats.n_static());
        Ok(usize::try_from(all.frames_budget(limit)).unwrap_or(usize::MAX))
    }
}

fn failed(error: GpuError) -> BackendError {
    BackendError(error.to_string())
}

impl Backend for GpuBackend {
    fn name(&self) -> String {
        self.gpu.adapter().name.clone()
    }

    fn is_synchronous(&self) -> bool {
        false
    }

    fn set_frames(&mut self, frames: Vec<Target>) -> Result<(), BackendError> {
        self.waiting = frames;
        Ok(())
    }

    fn set_exposures(&mut self, exposures: &[Exposure]) -> Result<(), BackendError> {
        self.trainer()?.set_exposures(exposures);
        Ok(())
    }

    fn upload(&mut self, splats: &Splats, adam: AdamState) -> Result<(), BackendError> {
        if let Some(trainer) = &mut self.trainer {
            return trainer.replace(splats, &adam).map_err(failed);
        }
        let frames = std::mem::take(&mut self.waiting);
        let budget = self.budget(splats, &frames).map_err(failed)?;
        let mut trainer =
            GpuTrainer::new(self.gpu.clone(), splats, &adam, &frames, budget).map_err(failed)?;
        trainer.set_limit(self.limit_bytes);
        if self.image_gradients {
            trainer.collect_image_gradients();
        }
        self.trainer = Some(trainer);
        Ok(())
    }

    fn take(&mut self) -> Result<(Splats, AdamState), BackendError> {
        self.trainer()?.download().map_err(failed)
    }

    fn splats(&mut self) -> Result<Splats, BackendError> {
        self.trainer()?.download_splats().map_err(failed)
    }

    fn set_splats(&mut self, splats: &Splats) -> Result<(), BackendError> {
        self.trainer()?.replace_splats(splats).map_err(failed)
    }

    fn reorder(&mut self) -> Result<(), BackendError> {
        self.trainer()?.reorder();
        Ok(())
    }

    fn step(
        &mut self,
        views: &[StepView<'_>],
        settings: &StepSettings<'_>,
    ) -> Result<(), BackendError> {
        self.trainer()?.step(views, settings).map_err(failed)
    }

    fn stats(&mut self) -> Result<StepStats, BackendError> {
        self.trainer()?.stats().map_err(failed)
    }

    fn collect_image_gradients(&mut self) {
        self.image_gradients = true;
        if let Some(trainer) = &mut self.trainer {
            trainer.collect_image_gradients();
        }
    }

    fn densify(&mut self, round: &DensityRound<'_>) -> Result<DensityStats, BackendError> {
        self.trainer()?.densify(round).map_err(failed)
    }

    fn colour_sums(
        &mut self,
        views: &[(usize, View)],
        with_weight: bool,
        stop: &dyn Fn() -> bool,
    ) -> Result<ColourSums, BackendError> {
        self.trainer()?
            .colour_sums(views, with_weight, stop)
            .map_err(failed)
    }
}
