//! Times training steps on a synthetic scene: the GPU version of [`crate::bench::Bench`].

use crate::adam::cpu::{AdamConfig, AdamState};
use crate::bench::{BenchScene, Kernel, Probe};
use crate::gpu::splats::DeviceSplats;
use crate::gpu::stopwatch::Laps;
use crate::gpu::work::{Size, Work};
use crate::gpu::{Found, Gpu, GpuError, Renderer, StepSettings, Trainer, device::failed, probe::probe};
use crate::{Frame, View};
use cubecl::MemoryScope;
use cubecl::profile::TimingMethod;

/// Weight of SSIM beside L1 (3DGS), as on the processor.
const LAMBDA_SSIM: f32 = 0.2;
/// Learning rate of every column, as on the processor: small, so that the scene stays what it is while it is timed.
const RATE: f32 = 1e-4;
const DOING: &str = "timing steps";

/// Memory of the device that is this process's, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeviceMemory {
    /// Of buffers that are in use now.
    pub in_use: u64,
    /// Taken from the driver: buffers, what is kept for those to come, staging. It rarely shrinks, so that it is close
    /// to the most that was ever taken.
    pub reserved: u64,
}

/// A scene on the device with all that a training step needs.
#[derive(Debug)]
pub struct Bench {
    gpu: Gpu,
    scene: BenchScene,
    rates: Vec<f32>,
    trainer: Trainer,
}

impl Bench {
    /// Copies `scene` to the device, and makes room for the tile lists of all its views.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if it does not fit or the device fails.
    pub fn new(gpu: Gpu, scene: BenchScene) -> Result<Self, GpuError> {
        let adam = AdamState::new(&scene.splats);
        let trainer = Trainer::new(gpu.clone(), &scene.splats, &adam, [&scene.target], usize::MAX)?;
        let mut bench = Self {
            rates: vec![RATE; scene.splats.columns().len()],
            trainer,
            gpu,
            scene,
        };
        // the first round may leave entries out and then makes room for them; the second has them all
        for _ in 0..2 {
            (0..bench.views()).try_for_each(|view| bench.step(view))?;
            bench.found()?;
        }
        Ok(bench)
    }

    /// Views to step or draw.
    #[must_use]
    pub fn views(&self) -> usize {
        self.scene.views.len()
    }

    /// One training step on view `view`; returns before the device is done.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if there is no room for its tile lists, or the device failed.
    pub fn step(&mut self, view: usize) -> Result<(), GpuError> {
        let settings = StepSettings {
            lambda_ssim: LAMBDA_SSIM,
            rates: &self.rates,
            adam: AdamConfig::default(),
        };
        self.trainer.step(0, &self.scene.views[view], &settings)
    }

    /// Waits, and says what the steps since the last call found.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed since.
    pub fn found(&mut self) -> Result<Found, GpuError> {
        self.trainer.found()
    }

    /// One training step on view `view`, each kernel timed on its own: by the device's clock, or, where
    /// [`own_clock`](Self::own_clock) is false, by waiting for the device after it.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device fails or cannot be timed.
    pub fn laps(&mut self, view: usize) -> Result<Laps, GpuError> {
        self.gpu.wait(DOING)?;
        self.trainer.work.stopwatch.start(&self.gpu);
        self.step(view)?;
        self.trainer.work.stopwatch.lap(&self.gpu, Kernel::Adam);
        self.trainer.work.stopwatch.stop(&self.gpu)
    }

    /// Whether kernels are timed by the device's own clock.
    #[must_use]
    pub fn own_clock(&self) -> bool {
        self.gpu.client.properties().timing_method == TimingMethod::Device
    }

    /// Entries of the tile lists of view `view`.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed.
    pub fn entries(&mut self, view: usize) -> Result<usize, GpuError> {
        self.step(view)?;
        self.trainer.work.entries(&self.gpu, DOING)
    }

    /// Entries of tile lists that there is room for.
    #[must_use]
    pub fn room(&self) -> usize {
        self.trainer.work.size.entries
    }

    /// The image drawn last.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed.
    pub fn frame(&self) -> Result<Frame, GpuError> {
        self.trainer.frame()
    }

    /// Waits for everything that was asked for.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.gpu.wait(DOING)
    }

    /// What the runtime says that it holds.
    #[must_use]
    pub fn memory(&self) -> DeviceMemory {
        self.gpu.memory()
    }

    /// Goes on with drawing alone.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if it does not fit or the device fails.
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
    #[must_use]
    pub fn views(&self) -> usize {
        self.views.len()
    }

    /// Draws view `view`; returns before the device is done. The image stays there.
    pub fn draw(&mut self, view: usize) {
        self.work.draw(&self.gpu, &self.splats, &self.views[view]);
    }

    /// Draws view `view`, each kernel timed on its own, as [`Bench::laps`] does.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device fails or cannot be timed.
    pub fn laps(&mut self, view: usize) -> Result<Laps, GpuError> {
        self.gpu.wait(DOING)?;
        self.work.stopwatch.start(&self.gpu);
        self.draw(view);
        self.work.stopwatch.stop(&self.gpu)
    }

    /// Draws view `view` and copies the image to the host.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device fails.
    pub fn read(&mut self, view: usize) -> Result<Frame, GpuError> {
        self.reader.render(&self.views[view])
    }

    /// Waits for everything that was asked for.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.gpu.wait(DOING)
    }
}

impl Gpu {
    /// What the runtime says that this process holds on the device.
    #[must_use]
    pub fn memory(&self) -> DeviceMemory {
        let usage = self.client.memory_report(MemoryScope::Device).usage();
        DeviceMemory {
            in_use: usage.bytes_in_use,
            reserved: usage.bytes_reserved,
        }
    }

    /// Gives what is in no buffer back to the driver, as far as the runtime does.
    ///
    /// # Errors
    ///
    /// [`GpuError::Failed`] if the device failed.
    pub fn give_back(&self) -> Result<(), GpuError> {
        let doing = "giving memory back";
        self.wait(doing)?;
        self.client.memory_cleanup().map_err(|error| failed(doing, &error))
    }

    /// What the device can do at most, measured now, on 256 MB.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed.
    pub fn probe(&self) -> Result<Probe, GpuError> {
        probe(self)
    }
}
