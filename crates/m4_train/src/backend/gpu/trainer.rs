//! A training run on the device: its state, upload and download.

use super::exposure;
use super::sum::Batch;
use crate::density::gpu::ImageGradients;
use m4_core::{Exposure, ShapeError, Splats, Window};
use m4_kernels::gpu::buffer::Buffer;
use m4_kernels::gpu::log::Log;
use m4_kernels::gpu::tally::Tally;
use m4_kernels::gpu::{Gpu, GpuError};
use m4_kernels::loss::gpu::Frames;
use m4_kernels::loss::gpu::Loss;
use m4_kernels::plan::Plan;
use m4_kernels::renderer::gpu::{Size, Work};
use m4_kernels::splats::{Bound, DeviceSplats, gathered, gathered_words, morton_order};
use m4_kernels::{
    CameraGradient, Frame, StepStats, View,
    adam::cpu::AdamState,
    adam::gpu::{DeviceAdam, DeviceNodes},
    loss::cpu::Target,
};
use std::borrow::Borrow;

/// The operation named in errors.
pub(super) const TRAINING: &str = "training";

/// Splats, their moments and the frames of a video on the device, and the step that moves them.
#[derive(Debug)]
pub struct GpuTrainer {
    pub(crate) gpu: Gpu,
    pub(crate) frames: Frames,
    pub(crate) splats: DeviceSplats,
    pub(crate) adam: DeviceAdam,
    pub(crate) gradients: DeviceSplats,
    pub(crate) work: Work,
    pub(crate) loss: Loss,
    pub(crate) tally: Tally,
    /// Where a step has several frames.
    pub(crate) batch: Option<Batch>,
    /// Where density control goes by them.
    pub(crate) image_gradients: Option<ImageGradients>,
    pub(crate) cameras: Log<10>,
    pub(crate) exposure_log: Log<{ exposure::NUMBERS }>,
    /// By frame; those beyond are not corrected.
    pub(crate) exposures: Vec<Exposure>,
    /// The image drawn last, corrected.
    pub(crate) exposed: Buffer,
    /// Whether there was room for the entries of a frame of these splats.
    pub(crate) fits: bool,
    limit_bytes: Option<u64>,
}

impl GpuTrainer {
    /// Copies everything to the device; of the `frames`, which have one size, those that fit into
    /// `budget_bytes`. The others stay here, three bytes per pixel, and are uploaded when they are
    /// used. Fails with [`GpuError`] if frames differ in size or there are none, if it does not
    /// fit, or if the device fails.
    pub fn new<T: Borrow<Target>>(
        gpu: Gpu,
        splats: &Splats,
        adam: &AdamState,
        frames: impl IntoIterator<Item = T>,
        budget_bytes: usize,
    ) -> Result<Self, GpuError> {
        check(splats, adam)?;
        let frames = Frames::new(&gpu, frames, budget_bytes)?;
        let size = Size {
            n: splats.n(),
            width: frames.width,
            height: frames.height,
            entries: Size::first_entries(splats.n()),
            training: true,
        };
        let splats = DeviceSplats::upload(&gpu, splats)?;
        let tally = Tally::new(&gpu, 1);
        let mut work = Work::new(&gpu, size)?;
        work.peak = tally.buffer.clone();
        Ok(Self {
            adam: uploaded(&gpu, adam)?,
            gradients: splats.like(&gpu),
            work,
            loss: Loss::new(&gpu, size.width, size.height),
            tally,
            batch: None,
            image_gradients: None,
            cameras: Log::default(),
            exposure_log: Log::default(),
            exposures: Vec::new(),
            exposed: Buffer::empty(&gpu.client, 1),
            fits: false,
            limit_bytes: None,
            frames,
            splats,
            gpu,
        })
    }

    /// The device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Splats on the device.
    pub fn n(&self) -> usize {
        self.splats.n
    }

    /// Draws `view`; the first time with these splats with as much room as it takes.
    pub(crate) fn draw(&mut self, view: &View) -> Result<(), GpuError> {
        let (k, size) = (&view.camera.intrinsics, self.work.size);
        ShapeError::check("columns of a view", self.frames.width, k.width)?;
        ShapeError::check("rows of a view", self.frames.height, k.height)?;
        // without memory since an error
        ShapeError::check("splats that there is memory for", self.splats.n, size.n)?;
        self.work.draw(&self.gpu, &self.splats, view);
        while !self.fits {
            let wanted = self.work.peak(&self.gpu, TRAINING)?;
            self.fits = wanted <= self.work.size.entries;
            if !self.fits {
                self.make_room(wanted)?;
                self.work.draw(&self.gpu, &self.splats, view);
            }
        }
        Ok(())
    }

    /// Refuses to take more than this many bytes from here on, by what is planned: `None` for no
    /// limit. Frames that turn out to need more room for their tile entries fail then.
    pub fn set_limit(&mut self, limit_bytes: Option<u64>) {
        self.limit_bytes = limit_bytes;
    }

    fn check_limit(&self, size: Size) -> Result<(), GpuError> {
        let Some(limit) = self.limit_bytes else {
            return Ok(());
        };
        let n_static = self.splats.n_static.min(size.n);
        let (layout, frames) = (self.splats.layout, self.frames.resident());
        let image = (size.width, size.height);
        let plan = Plan::training(
            n_static,
            size.n - n_static,
            layout,
            image,
            frames,
            size.entries,
        );
        let plan = match self.batch {
            Some(_) => plan.with_batches(),
            None => plan,
        };
        let plan = match &self.splats.bound {
            Some(bound) => plan.with_bound(bound.n.min(size.n - n_static), bound.windows()),
            None => plan,
        };
        let plan = match self.image_gradients {
            Some(_) => plan.with_image_gradients(),
            None => plan,
        };
        plan.check(limit)
    }

    /// Makes room for a frame of `wanted` entries, and a quarter more.
    fn make_room(&mut self, wanted: usize) -> Result<(), GpuError> {
        self.make(Size {
            entries: wanted + wanted / 4,
            ..self.work.size
        })
    }

    /// Memory for `size`, where it is another one.
    pub(crate) fn make(&mut self, size: Size) -> Result<(), GpuError> {
        self.fits = false;
        if size == self.work.size {
            return Ok(());
        }
        self.check_limit(size)?;
        let peak = self.work.peak.clone();
        self.work.remake(&self.gpu, size)?;
        self.work.peak = peak;
        Ok(())
    }

    /// Waits, and returns the statistics of the steps since the last call, by one small read. Makes
    /// room for more tile entries where frames had more than there was room for; those frames moved
    /// nothing. Fails with [`GpuError`] if the device failed since.
    pub fn stats(&mut self) -> Result<StepStats, GpuError> {
        let (mut stats, entries) = self.tally.take(&self.gpu, TRAINING)?;
        let cameras = self.cameras.take(&self.gpu, TRAINING)?;
        stats.cameras = cameras
            .into_iter()
            .map(|(f, row)| (f, camera(row)))
            .collect();
        stats.exposures = self.exposure_log.take(&self.gpu, TRAINING)?;
        self.work.peak = self.tally.buffer.clone();
        if entries > self.work.size.entries {
            self.make_room(entries)?;
        }
        Ok(stats)
    }

    /// Tile entries that there is room for.
    pub fn room(&self) -> usize {
        self.work.size.entries
    }

    /// The image drawn last. Fails with [`GpuError`] if the device failed since.
    pub fn frame(&self) -> Result<Frame, GpuError> {
        let image = self.work.image.read_floats(&self.gpu.client, TRAINING)?;
        let Size { width, height, .. } = self.work.size;
        let pixels = width * height;
        let plane = |k: usize| image[k * pixels..(k + 1) * pixels].to_vec();
        Ok(Frame {
            width,
            height,
            rgb: [plane(0), plane(1), plane(2)],
            transmittance: plane(3),
            depth: Vec::new(),
        })
    }

    /// Waits, and copies splats and the optimiser's state back. Fails with [`GpuError`] if the
    /// device failed since.
    pub fn download(&self) -> Result<(Splats, AdamState), GpuError> {
        Ok((self.download_splats()?, self.download_adam()?))
    }

    /// Lays splats and the optimiser's state out again, nearly as [`m4_kernels::morton_order`]
    /// does. Nothing leaves the device.
    pub fn reorder(&mut self) {
        let (n, n_static) = (self.splats.n, self.splats.n_static);
        if n > 0 {
            let order = morton_order(&self.gpu, &self.splats);
            self.gather_adam(&order, (n, n_static));
            if let Some(sums) = &mut self.image_gradients {
                sums.rearrange(&self.gpu, &order, n);
            }
            let bound = self.splats.bound.as_ref();
            let bound =
                bound.map(|bound| bound.gathered(&self.gpu, &order, n_static, (n_static, bound.n)));
            let splats = gathered(&self.gpu, &self.splats, &order, (n, n_static));
            self.splats = DeviceSplats { bound, ..splats };
        }
    }

    /// The optimiser's state of the rows named, `shape` splats and static ones among them; zeros
    /// where there is no row.
    pub(crate) fn gather_adam(&mut self, rows: &Buffer, shape: (usize, usize)) {
        let (gpu, adam) = (&self.gpu, &self.adam);
        self.adam = DeviceAdam {
            m: gathered(gpu, &adam.m, rows, shape),
            v: gathered(gpu, &adam.v, rows, shape),
            steps: gathered_words(gpu, &adam.steps, rows, shape.0),
            nodes: adam.nodes.clone(),
        };
    }

    /// Waits, and copies the splats back. Fails with [`GpuError`] if the device failed since.
    pub fn download_splats(&self) -> Result<Splats, GpuError> {
        self.splats.download(&self.gpu, TRAINING)
    }

    /// Waits, and copies the optimiser's state back. Fails with [`GpuError`] if the device failed
    /// since.
    pub fn download_adam(&self) -> Result<AdamState, GpuError> {
        let mut step = self.adam.steps.read_words(&self.gpu.client, TRAINING)?;
        step.truncate(self.splats.n);
        Ok(AdamState {
            m: self.adam.m.download(&self.gpu, TRAINING)?,
            v: self.adam.v.download(&self.gpu, TRAINING)?,
            step,
            nodes: self
                .adam
                .nodes
                .download(&self.gpu, windows(&self.splats), TRAINING)?,
        })
    }

    /// Goes on with other splats and another state of the optimiser. Fails with [`GpuError`] if
    /// they do not fit, or not together; the trainer is not to be used after that.
    pub fn replace(&mut self, splats: &Splats, adam: &AdamState) -> Result<(), GpuError> {
        check(splats, adam)?;
        self.adam = uploaded(&self.gpu, adam)?;
        self.replace_splats(splats)
    }

    /// Uploads `splats` and makes what depends on their number. Fails with [`GpuError`] if they do
    /// not fit, or the state of the optimiser is that of other windows.
    pub fn replace_splats(&mut self, splats: &Splats) -> Result<(), GpuError> {
        self.adam.nodes.fit(splats.windows())?;
        self.splats = DeviceSplats::upload(&self.gpu, splats)?;
        self.gradients = self.splats.like(&self.gpu);
        self.make(Size {
            n: splats.n(),
            ..self.work.size
        })
    }
}

/// The optimiser's state on the device.
fn uploaded(gpu: &Gpu, adam: &AdamState) -> Result<DeviceAdam, GpuError> {
    Ok(DeviceAdam {
        m: DeviceSplats::upload(gpu, &adam.m)?,
        v: DeviceSplats::upload(gpu, &adam.v)?,
        steps: Buffer::words(&gpu.client, &adam.step),
        nodes: DeviceNodes::upload(gpu, &adam.nodes)?,
    })
}

/// The windows of splats, none of which are bound without.
fn windows(splats: &DeviceSplats) -> &[Window] {
    splats.bound.as_ref().map_or(&[], Bound::windows)
}

/// A row of the log of cameras.
fn camera(row: [f64; 10]) -> CameraGradient {
    let [tx, ty, tz, rx, ry, rz, fx, fy, cx, cy] = row;
    CameraGradient {
        tau: [tx, ty, tz],
        omega: [rx, ry, rz],
        intrinsics: [fx, fy, cx, cy],
    }
}

/// The state is that of these splats.
fn check(splats: &Splats, adam: &AdamState) -> Result<(), ShapeError> {
    let columns = splats.layout().columns();
    for of in [&adam.m, &adam.v] {
        ShapeError::check("splats of the optimiser", splats.n(), of.n())?;
        ShapeError::check(
            "static splats of the optimiser",
            splats.n_static(),
            of.n_static(),
        )?;
        ShapeError::check("columns of the optimiser", columns, of.layout().columns())?;
    }
    DeviceNodes::check(&adam.nodes, splats.windows())?;
    ShapeError::check("counts of steps", splats.n(), adam.step.len())
}
