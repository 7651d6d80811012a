//! Whole training steps on the device.

use crate::buffer::{Buffer, cubes, units};
use crate::splats::{DeviceSplats, parts};
use crate::work::{Size, Work};
use crate::{Gpu, GpuError, adam, photo};
use cubecl::prelude::CubeCount;
use m4_kernels::{
    Frame, View,
    adam::cpu::{AdamConfig, AdamState},
};
use m4_scene::{RgbImage, Splats};

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

/// What steps found since the last time it was asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Steps.
    pub steps: usize,
    /// Mean of the absolute differences over channels, pixels and steps.
    pub l1: f64,
    /// Mean structural similarity.
    pub ssim: f64,
    /// Splats that the last step moved.
    pub touched: usize,
}

/// Splats, their moments and the frames of a video on the device, and the step that moves them.
#[derive(Debug)]
pub struct Trainer {
    gpu: Gpu,
    frames: Vec<Buffer>,
    width: usize,
    height: usize,
    splats: DeviceSplats,
    m: DeviceSplats,
    v: DeviceSplats,
    steps: Buffer,
    gradients: DeviceSplats,
    work: Work,
    /// SSIM's derivatives, three planes a channel.
    slopes: Buffer,
    /// Two sums a tile and channel.
    sums: Buffer,
    totals: Buffer,
}

impl Trainer {
    /// Copies everything to the device. All `frames` have the size of the first.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if it does not fit or the device fails.
    pub fn new<'a>(
        gpu: Gpu,
        splats: &Splats,
        adam: &AdamState,
        frames: impl IntoIterator<Item = &'a RgbImage>,
    ) -> Result<Self, GpuError> {
        let (mut width, mut height) = (0, 0);
        let frames = frames
            .into_iter()
            .map(|frame| {
                (width, height) = frame.size();
                Buffer::words(&gpu.client, &packed(frame))
            })
            .collect();
        let size = Size {
            n: splats.n(),
            width,
            height,
            entries: (FIRST_ENTRIES * splats.n()).max(1 << 16),
            training: true,
        };
        let splats = DeviceSplats::upload(&gpu, splats)?;
        let tiles = size.tiles();
        Ok(Self {
            m: DeviceSplats::upload(&gpu, &adam.m)?,
            v: DeviceSplats::upload(&gpu, &adam.v)?,
            steps: Buffer::words(&gpu.client, &adam.step),
            gradients: splats.like(&gpu),
            work: Work::new(&gpu, size)?,
            slopes: Buffer::empty(&gpu.client, 9 * width * height),
            sums: Buffer::empty(&gpu.client, 6 * tiles),
            totals: Buffer::floats(&gpu.client, &[0.0; 3]),
            frames,
            width,
            height,
            splats,
            gpu,
        })
    }

    /// The device.
    #[must_use]
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Draws `view`, compares it with frame `frame`, and moves every splat that was seen. Returns before the device is
    /// done; nothing is read back.
    pub fn step(&mut self, frame: usize, view: &View, settings: &StepSettings<'_>) {
        let client = &self.gpu.client;
        let (w, h) = (self.width as u32, self.height as u32);
        self.work.draw(&self.gpu, &self.splats, view);
        let tiles = self.work.size.tiles();
        let planes = || CubeCount::Static(tiles as u32, 3, 1);
        let (image, target) = (&self.work.image, &self.frames[frame]);
        photo::similarity::launch(
            client,
            planes(),
            units(),
            image.arg(),
            target.arg(),
            self.slopes.arg(),
            self.sums.arg(),
            w,
            h,
        );
        photo::gradient::launch(
            client,
            planes(),
            units(),
            image.arg(),
            target.arg(),
            self.slopes.arg(),
            self.work.gradient.arg(),
            w,
            h,
            settings.lambda_ssim,
        );
        let count = 3.0 * (self.width * self.height) as f32;
        photo::add_up::launch(
            client,
            cubes(1, 1),
            units(),
            self.sums.arg(),
            self.totals.arg(),
            3 * tiles as u32,
            count,
        );
        self.work
            .backward(&self.gpu, &self.splats, &self.gradients, view.mip, false, false);
        self.move_splats(settings);
    }

    fn move_splats(&self, settings: &StepSettings<'_>) {
        let client = &self.gpu.client;
        let (n, n_static) = (self.splats.n, self.splats.n_static);
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

    /// Waits, and says what the steps since the last call found. Makes room for more tile entries where frames had more
    /// than there was room for; those left out were the farthest.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed since.
    pub fn found(&mut self) -> Result<Found, GpuError> {
        let (client, doing) = (&self.gpu.client, "training");
        let totals = self.totals.read_floats(client, doing)?;
        let touched = self.work.touched.read_words(client, doing)?;
        let peak = self.work.peak(&self.gpu, doing)?;
        self.totals = Buffer::floats(client, &[0.0; 3]);
        let touched = touched[..self.splats.n].iter().filter(|&&t| t != 0).count();
        if peak > self.work.size.entries {
            let size = Size {
                entries: peak + peak / 4,
                ..self.work.size
            };
            self.work = Work::new(&self.gpu, size)?;
        }
        let steps = totals[2].max(1.0);
        Ok(Found {
            steps: totals[2] as usize,
            // three channels share the count
            ssim: f64::from(totals[0] / steps),
            l1: f64::from(totals[1] / steps),
            touched,
        })
    }

    /// The picture drawn last.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed since.
    pub fn frame(&self) -> Result<Frame, GpuError> {
        let image = self.work.image.read_floats(&self.gpu.client, "training")?;
        let pixels = self.width * self.height;
        let plane = |k: usize| image[k * pixels..(k + 1) * pixels].to_vec();
        Ok(Frame {
            width: self.width,
            height: self.height,
            rgb: [plane(0), plane(1), plane(2)],
            transmittance: plane(3),
            depth: Vec::new(),
        })
    }

    /// Waits, and copies splats and moments back.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed since.
    pub fn download(&self) -> Result<(Splats, AdamState), GpuError> {
        let doing = "training";
        let splats = self.splats.download(&self.gpu, doing)?;
        let mut step = self.steps.read_words(&self.gpu.client, doing)?;
        step.truncate(splats.n());
        let adam = AdamState {
            m: self.m.download(&self.gpu, doing)?,
            v: self.v.download(&self.gpu, doing)?,
            step,
        };
        Ok((splats, adam))
    }

    /// Goes on with other splats.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if they do not fit.
    pub fn replace(&mut self, splats: &Splats, adam: &AdamState) -> Result<(), GpuError> {
        let changed = splats.n() != self.splats.n;
        self.splats = DeviceSplats::upload(&self.gpu, splats)?;
        self.m = DeviceSplats::upload(&self.gpu, &adam.m)?;
        self.v = DeviceSplats::upload(&self.gpu, &adam.v)?;
        self.steps = Buffer::words(&self.gpu.client, &adam.step);
        self.gradients = self.splats.like(&self.gpu);
        if changed {
            let size = Size {
                n: splats.n(),
                ..self.work.size
            };
            self.work = Work::new(&self.gpu, size)?;
        }
        Ok(())
    }
}

/// Eight bits a channel, red lowest, in one number a pixel.
fn packed(frame: &RgbImage) -> Vec<u32> {
    let (_, height) = frame.size();
    let pixels = (0..height).flat_map(|y| frame.row(y));
    pixels
        .map(|&[r, g, b]| u32::from(r) | u32::from(g) << 8 | u32::from(b) << 16)
        .collect()
}
