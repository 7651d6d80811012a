//! Times training steps on a synthetic scene: the GPU version of [`m4_kernels::bench::Bench`].

use super::GpuTrainer;
use crate::backend::{StepSettings, StepView};
use m4_kernels::adam::{
    cpu::{AdamConfig, AdamState},
    nodes::NodeRates,
};
use m4_kernels::bench::BenchScene;
use m4_kernels::gpu::{DeviceMemory, Gpu, GpuError, Laps};
use m4_kernels::renderer::gpu::{Renderer, Size, Work};
use m4_kernels::splats::DeviceSplats;
use m4_kernels::{Frame, Kernel, StepStats, View};

/// Weight of SSIM beside L1 (3DGS), as on the processor.
const LAMBDA_SSIM: f32 = 0.2;
/// Learning rate of every column, as on the processor: small, so that the scene stays what it is
/// while it is timed.
const RATE: f32 = 1e-4;
const DOING: &str = "timing steps";

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
        let trainer = GpuTrainer::new(
            gpu.clone(),
            &scene.splats,
            &adam,
            [&scene.target],
            usize::MAX,
        )?;
        let mut bench = Self {
            rates: vec![RATE; scene.splats.columns().len()],
            trainer,
            gpu,
            scene,
        };
        // the first round may leave entries out and then makes room for them; the second has them
        // all
        for _ in 0..2 {
            (0..bench.views()).try_for_each(|view| bench.step(view))?;
            bench.stats()?;
        }
        Ok(bench)
    }

    /// Views to step or draw.
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
            nodes: NodeRates {
                position: RATE,
                turn: RATE,
            },
            adam: AdamConfig::default(),
            psnr: false,
        };
        self.trainer
            .step(&[StepView::new(0, &self.scene.views[view])], &settings)
    }

    /// Waits, and returns the statistics of the steps since the last call.
    /// Fails with [`GpuError`] if the device failed since.
    pub fn stats(&mut self) -> Result<StepStats, GpuError> {
        self.trainer.stats()
    }

    /// One training step on view `view`, each kernel timed on its own: by the device's clock, or,
    /// where [`own_clock`](Self::own_clock) is false, by waiting for the device after it. Fails
    /// with [`GpuError`] if the device fails or cannot be timed.
    pub fn laps(&mut self, view: usize) -> Result<Laps, GpuError> {
        self.gpu.wait(DOING)?;
        self.trainer.work.stopwatch.start(&self.gpu);
        self.step(view)?;
        self.trainer.work.stopwatch.lap(&self.gpu, Kernel::Adam);
        self.trainer.work.stopwatch.stop(&self.gpu)
    }

    /// Whether kernels are timed by the device's own clock.
    pub fn own_clock(&self) -> bool {
        self.gpu.has_own_clock()
    }

    /// Entries of the tile lists of view `view`. Fails with [`GpuError`] if the device failed.
    pub fn entries(&mut self, view: usize) -> Result<usize, GpuError> {
        self.step(view)?;
        self.trainer.work.entries(&self.gpu, DOING)
    }

    /// Entries of tile lists that there is room for.
    pub fn room(&self) -> usize {
        self.trainer.room()
    }

    /// The image drawn last. Fails with [`GpuError`] if the device failed.
    pub fn frame(&self) -> Result<Frame, GpuError> {
        self.trainer.frame()
    }

    /// Waits for everything that was asked for. Fails with [`GpuError`] if the device failed.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.gpu.wait(DOING)
    }

    /// What the runtime says that it holds.
    pub fn memory(&self) -> DeviceMemory {
        self.gpu.memory()
    }

    /// Goes on with drawing alone. Fails with [`GpuError`] if it does not fit or the device fails.
    pub fn into_drawing(self) -> Result<Drawing, GpuError> {
        let (entries, gpu) = (self.trainer.work.size.entries, self.gpu);
        drop(self.trainer);
        let first = &self.scene.views[0].camera.intrinsics;
        let size = Size {
            n: self.scene.splats.n(),
            width: first.width,
            height: first.height,
            entries,
            training: false,
        };
        Ok(Drawing {
            splats: DeviceSplats::upload(&gpu, &self.scene.splats)?,
            work: Work::new(&gpu, size)?,
            reader: Renderer::new(gpu.clone(), &self.scene.splats)?,
            views: self.scene.views,
            gpu,
        })
    }
}

/// Images alone.
#[derive(Debug)]
pub struct Drawing {
    gpu: Gpu,
    splats: DeviceSplats,
    views: Vec<View>,
    work: Work,
    reader: Renderer,
}

impl Drawing {
    /// Views to draw.
    pub fn views(&self) -> usize {
        self.views.len()
    }

    /// Draws view `view`; returns before the device is done. The image stays there.
    pub fn draw(&mut self, view: usize) {
        self.work.draw(&self.gpu, &self.splats, &self.views[view]);
    }

    /// Draws view `view`, each kernel timed on its own, as [`Bench::laps`] does.
    /// Fails with [`GpuError`] if the device fails or cannot be timed.
    pub fn laps(&mut self, view: usize) -> Result<Laps, GpuError> {
        self.gpu.wait(DOING)?;
        self.work.stopwatch.start(&self.gpu);
        self.draw(view);
        self.work.stopwatch.stop(&self.gpu)
    }

    /// Draws view `view` and copies the image to the host. Fails with [`GpuError`] if the device
    /// fails.
    pub fn read(&mut self, view: usize) -> Result<Frame, GpuError> {
        self.reader.render(&self.views[view])
    }

    /// Waits for everything that was asked for. Fails with [`GpuError`] if the device failed.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.gpu.wait(DOING)
    }
}
