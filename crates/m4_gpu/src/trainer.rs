//! Whole training steps on the device.

use crate::buffer::{Buffer, cubes, units};
use crate::found::{Found, Tally};
use crate::frames::Frames;
use crate::loss::Loss;
use crate::splats::{DeviceSplats, parts};
use crate::work::{Size, Work};
use crate::{Gpu, GpuError, adam};
use m4_kernels::{
    Frame, View,
    adam::cpu::{AdamConfig, AdamState},
    photo::cpu::Target,
};
use m4_scene::Splats;
use std::borrow::Borrow;

/// What goes on, for errors.
pub(crate) const TRAINING: &str = "training";

/// Entries of tiles that memory is first made for, for each splat.
const FIRST_ENTRIES: usize = 4;

/// What a step depends on besides splats and frame.
#[derive(Debug, Clone, Copy)]
pub struct StepSettings<'a> {
    /// Share of SSIM in the loss, 0..=1.
    pub lambda_ssim: f32,
    /// One learning rate a column of the splats.
    pub rates: &'a [f32],
    /// The optimiser.
    pub adam: AdamConfig,
    /// The count of steps of all splats, this one included; `None` where each splat has its own.
    pub shared_steps: Option<u32>,
}

/// Splats, their moments and the frames of a video on the device, and the step that moves them.
#[derive(Debug)]
pub struct Trainer {
    pub(crate) gpu: Gpu,
    pub(crate) frames: Frames,
    pub(crate) splats: DeviceSplats,
    pub(crate) m: DeviceSplats,
    pub(crate) v: DeviceSplats,
    pub(crate) steps: Buffer,
    pub(crate) gradients: DeviceSplats,
    pub(crate) work: Work,
    pub(crate) loss: Loss,
    pub(crate) tally: Tally,
    /// Whether there was room for the entries of a frame of these splats at this size.
    pub(crate) fits: bool,
}

impl Trainer {
    /// Copies everything to the device; of the `frames`, which have one size, those that fit into `budget_bytes`. The
    /// others stay here, three bytes a pixel (six for those that were made smaller), and are uploaded when they are used.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if frames differ in size or there are none, if it does not fit, or if the device fails.
    pub fn new<T: Borrow<Target>>(
        gpu: Gpu,
        splats: &Splats,
        adam: &AdamState,
        frames: impl IntoIterator<Item = T>,
        budget_bytes: usize,
    ) -> Result<Self, GpuError> {
        let frames = Frames::new(&gpu, frames, budget_bytes)?;
        let size = Size {
            n: splats.n(),
            width: frames.width,
            height: frames.height,
            entries: (FIRST_ENTRIES * splats.n()).max(1 << 16),
            training: true,
        };
        let splats = DeviceSplats::upload(&gpu, splats)?;
        let tally = Tally::new(&gpu, frames.len(), size.n);
        let mut work = Work::new(&gpu, size)?;
        work.peak = tally.buffer.clone();
        Ok(Self {
            m: DeviceSplats::upload(&gpu, &adam.m)?,
            v: DeviceSplats::upload(&gpu, &adam.v)?,
            steps: Buffer::words(&gpu.client, &adam.step),
            gradients: splats.like(&gpu),
            work,
            loss: Loss::new(&gpu, size),
            tally,
            fits: false,
            frames,
            splats,
            gpu,
        })
    }

    /// The device.
    #[must_use]
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Goes on with other frames, which may have another size (coarse to fine); as in [`new`](Self::new). What steps
    /// found with those before is forgotten: [`found`](Self::found) comes first.
    ///
    /// # Errors
    ///
    /// As [`new`](Self::new); the frames before are kept then.
    pub fn set_frames<T: Borrow<Target>>(
        &mut self,
        frames: impl IntoIterator<Item = T>,
        budget_bytes: usize,
    ) -> Result<(), GpuError> {
        let frames = Frames::new(&self.gpu, frames, budget_bytes)?;
        let size = Size {
            width: frames.width,
            height: frames.height,
            ..self.work.size
        };
        self.make(size)?;
        self.tally = Tally::new(&self.gpu, frames.len(), size.n);
        self.work.peak = self.tally.buffer.clone();
        self.frames = frames;
        Ok(())
    }

    /// Draws `view`, compares it with frame `frame`, and moves every splat that was seen. Returns before the device is
    /// done; nothing is read back but, in the first step after splats or frames were replaced, how many tile entries there
    /// are.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if there is no room for the tile entries, or if the device failed.
    ///
    /// # Panics
    ///
    /// If there is no frame `frame`.
    pub fn step(&mut self, frame: usize, view: &View, settings: &StepSettings<'_>) -> Result<(), GpuError> {
        self.draw(view)?;
        let target = self.frames.get(&self.gpu, frame);
        let (gpu, image, lambda) = (&self.gpu, &self.work.image, settings.lambda_ssim);
        self.loss.compare(gpu, image, &target, frame, lambda, &self.tally);
        self.loss.gradient(gpu, image, &target, lambda, &self.work.gradient);
        self.work
            .backward(gpu, &self.splats, &self.gradients, view.mip, false, false);
        self.move_splats(settings);
        Ok(())
    }

    /// Draws `view`; the first time with these splats at this size with as much room as it takes.
    pub(crate) fn draw(&mut self, view: &View) -> Result<(), GpuError> {
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

    /// Makes room for a frame of `wanted` entries, and a quarter more.
    fn make_room(&mut self, wanted: usize) -> Result<(), GpuError> {
        self.make(Size {
            entries: wanted + wanted / 4,
            ..self.work.size
        })
    }

    /// Memory for frames of `size`, where it is another one.
    pub(crate) fn make(&mut self, size: Size) -> Result<(), GpuError> {
        self.fits = false;
        if size == self.work.size {
            return Ok(());
        }
        let (old, peak) = (self.work.size, self.work.peak.clone());
        self.work.remake(&self.gpu, size)?;
        self.work.peak = peak;
        if (old.width, old.height) != (size.width, size.height) {
            self.loss = Loss::new(&self.gpu, size);
        }
        if old.n != size.n {
            self.tally.resize(&self.gpu, size.n);
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
            settings.shared_steps.unwrap_or(0),
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

    /// Waits, and says what the steps since the last call found, by one small read. Makes room for more tile entries where
    /// frames had more than there was room for; those left out were the farthest.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed since.
    pub fn found(&mut self) -> Result<Found, GpuError> {
        let found = self.tally.take(&self.gpu, TRAINING)?;
        self.work.peak = self.tally.buffer.clone();
        if found.entries > self.work.size.entries {
            self.make_room(found.entries)?;
        }
        Ok(found)
    }

    /// The picture drawn last.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed since.
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

    /// Waits, and copies splats and the optimiser's state back.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed since.
    pub fn download(&self) -> Result<(Splats, AdamState), GpuError> {
        Ok((self.download_splats()?, self.download_adam()?))
    }

    /// Waits, and copies the splats back.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed since.
    pub fn download_splats(&self) -> Result<Splats, GpuError> {
        self.splats.download(&self.gpu, TRAINING)
    }

    /// Waits, and copies the optimiser's state back.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed since.
    pub fn download_adam(&self) -> Result<AdamState, GpuError> {
        let mut step = self.steps.read_words(&self.gpu.client, TRAINING)?;
        step.truncate(self.splats.n);
        Ok(AdamState {
            m: self.m.download(&self.gpu, TRAINING)?,
            v: self.v.download(&self.gpu, TRAINING)?,
            step,
        })
    }

    /// Goes on with other splats and another state of the optimiser.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if they do not fit; the trainer is not to be used after that.
    pub fn replace(&mut self, splats: &Splats, adam: &AdamState) -> Result<(), GpuError> {
        self.m = DeviceSplats::upload(&self.gpu, &adam.m)?;
        self.v = DeviceSplats::upload(&self.gpu, &adam.v)?;
        self.steps = Buffer::words(&self.gpu.client, &adam.step);
        self.replace_splats(splats)
    }

    /// Uploads `splats` and makes what depends on their number.
    pub(crate) fn replace_splats(&mut self, splats: &Splats) -> Result<(), GpuError> {
        self.splats = DeviceSplats::upload(&self.gpu, splats)?;
        self.gradients = self.splats.like(&self.gpu);
        self.make(Size {
            n: splats.n(),
            ..self.work.size
        })
    }
}
