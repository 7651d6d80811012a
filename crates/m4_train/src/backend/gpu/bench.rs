//! Times training steps on a synthetic scene: the GPU version of [`m4_kernels::bench::Bench`].

use super::GpuTrainer;
use crate::backend::{StepSettings, StepView};
use m4_kernels::adam::cpu::{AdamConfig, AdamState};
use m4_kernels::bench::BenchScene;
use m4_kernels::gpu::{Gpu, GpuError, Renderer};
use m4_kernels::{StepStats, View};

/// Weight of SSIM beside L1 (3DGS), as on the processor.
const LAMBDA_SSIM: f32 = 0.2;
/// Learning rate of every column, as on the processor: small, so that the scene stays what it is while it is timed.
const RATE: f32 = 1e-4;

/// A scene on the device with all that a training step needs.
#[derive(Debug)]
pub struct Bench {
    gpu: Gpu,
    scene: BenchScene,
    rates: Vec<f32>,
    trainer: GpuTrainer,
}

impl Bench {
    /// Copies `scene` to the device, and makes room for the tile lists of all its views.
    /// Fails with [`GpuError`] if it does not fit or the device fails.
    pub fn new(gpu: Gpu, scene: BenchScene) -> Result<Self, GpuError> {
        let adam = AdamState::new(&scene.splats);
        let trainer = GpuTrainer::new(gpu.clone(), &scene.splats, &adam, [&scene.target], usize::MAX)?;
        let mut bench = Self { rates: vec![RATE; scene.splats.columns().len()], trainer, gpu, scene };
        // the first round may leave entries out and then makes room for them; the second has them all
        for _ in 0..2 {
            (0..bench.views()).try_for_each(|view| bench.step(view))?;
            bench.stats()?;
        }
        Ok(bench)
    }

    /// Views to step.
    pub fn views(&self) -> usize {
        self.scene.views.len()
    }

    /// One training step on view `view`; returns before the device is done.
    /// Fails with [`GpuError`] if there is no room for its tile lists, or the device failed.
    pub fn step(&mut self, view: usize) -> Result<(), GpuError> {
        let settings = StepSettings {
            lambda_ssim: LAMBDA_SSIM,
            cover: 0.0,
            rates: &self.rates,
            adam: AdamConfig::default(),
            psnr: false,
        };
        self.trainer.step(&[StepView::new(0, &self.scene.views[view])], &settings)
    }

    /// Waits, and returns the statistics of the steps since the last call.
    /// Fails with [`GpuError`] if the device failed since.
    pub fn stats(&mut self) -> Result<StepStats, GpuError> {
        self.trainer.stats()
    }

    /// Entries of the tile lists of view `view`. Fails with [`GpuError`] if the device failed.
    pub fn entries(&mut self, view: usize) -> Result<usize, GpuError> {
        self.step(view)?;
        self.trainer.work.entries(&self.gpu, "timing steps")
    }

    /// Entries of tile lists that there is room for.
    pub fn room(&self) -> usize {
        self.trainer.room()
    }

    /// Goes on with a renderer of the same splats, and the views to render. Fails with [`GpuError`] if they do not fit.
    pub fn into_renderer(self) -> Result<(Renderer, Vec<View>), GpuError> {
        drop(self.trainer);
        Ok((Renderer::new(self.gpu, &self.scene.splats)?, self.scene.views))
    }
}
