//! Exposures on the device, and the sums for the least-squares fit of colours: the residual of a
//! splat's pixels, and the weight of the splat in them.
#![expect(
    clippy::collapsible_if,
    reason = "kernels are expanded: conditions at compile time stand alone"
)]

use crate::backend::{
    ColourSums,
    gpu::{GpuTrainer, trainer::TRAINING},
};
use cubecl::prelude::*;
use m4_core::Exposure;
use m4_kernels::launch;
use m4_kernels::{
    View,
    adam::FIXED,
    gpu::{
        Gpu, GpuError,
        buffer::{Buffer, cubes, units},
        log::write_parts,
    },
    loss::gpu::target_at,
};

/// Of an exposure: rows of the matrix, each followed by its offset.
pub(crate) const NUMBERS: usize = 12;

impl GpuTrainer {
    /// The correction of each frame from here on, by number: steps, scores and sums of colours
    /// compare `matrix rgb + offset` with the frame. Frames that the list does not reach, all of
    /// them for an empty one, are not corrected.
    pub fn set_exposures(&mut self, exposures: &[Exposure]) {
        self.exposures = exposures.to_vec();
    }

    /// The image drawn last as frame `frame` shows it, and the correction if there is one.
    pub(crate) fn corrected(&mut self, frame: usize) -> (Buffer, Option<Buffer>) {
        let (client, pixels) = (&self.gpu.client, self.work.size.pixels());
        let Some(exposure) = self.exposures.get(frame) else {
            return (self.work.image.clone(), None);
        };
        let exposure = numbers(&self.gpu, exposure);
        if self.exposed.len() != 3 * pixels {
            self.exposed = Buffer::empty(client, 3 * pixels);
        }
        launch!(
            client,
            expose::launch,
            (cubes(pixels, 256), units()),
            [self.work.image, exposure, self.exposed],
            [pixels as u32]
        );
        (self.exposed.clone(), Some(exposure))
    }

    /// Turns the gradient of corrected colours into that of the colours drawn; `log` also keeps
    /// that of the correction.
    pub(crate) fn pull_back(&mut self, frame: usize, exposure: &Buffer, log: bool) {
        let (gpu, pixels) = (&self.gpu, self.work.size.pixels());
        let parts = log.then(|| self.exposure_log.next(gpu, frame, pixels));
        // any other memory where nothing is written
        let parts = parts.as_ref().unwrap_or(&self.exposed);
        launch!(
            &gpu.client,
            pull_back::launch,
            (cubes(pixels, 256), units()),
            [self.work.image, exposure, self.work.gradient, parts],
            [pixels as u32, log]
        );
        if log {
            self.exposure_log.add_up(gpu);
        }
    }
}

fn numbers(gpu: &Gpu, exposure: &Exposure) -> Buffer {
    let mut out = [0.0; NUMBERS];
    for (r, row) in out.chunks_mut(4).enumerate() {
        row[..3].copy_from_slice(&exposure.matrix[r]);
        row[3] = exposure.offset[r];
    }
    Buffer::floats(&gpu.client, &out)
}

#[cube(launch)]
fn expose(image: &[f32], exposure: &[f32], out: &mut [f32], pixels: u32) {
    let i = ABSOLUTE_POS;
    let all = pixels as usize;
    if i < all {
        let (red, green, blue) = (image[i], image[all + i], image[2 * all + i]);
        #[unroll]
        for r in 0usize..3usize {
            out[r * all + i] = exposure[4 * r] * red
                + exposure[4 * r + 1] * green
                + exposure[4 * r + 2] * blue
                + exposure[4 * r + 3];
        }
    }
}

/// `gradient` becomes the matrix's transpose times itself; `parts` get the gradient of the
/// correction, summed a cube.
#[cube(launch)]
fn pull_back(
    image: &[f32],
    exposure: &[f32],
    gradient: &mut [f32],
    parts: &mut [f32],
    pixels: u32,
    #[comptime] log: bool,
) {
    let mut share = Array::<f32>::new(12usize);
    if comptime!(log) {
        #[unroll]
        for k in 0usize..12usize {
            share[k] = f32::new(0.0f32);
        }
    }
    let i = ABSOLUTE_POS;
    let all = pixels as usize;
    if i < all {
        let (g0, g1, g2) = (gradient[i], gradient[all + i], gradient[2 * all + i]);
        if comptime!(log) {
            let (red, green, blue) = (image[i], image[all + i], image[2 * all + i]);
            #[unroll]
            for r in 0usize..3usize {
                let g = gradient[r * all + i];
                share[4 * r] = g * red;
                share[4 * r + 1] = g * green;
                share[4 * r + 2] = g * blue;
                share[4 * r + 3] = g;
            }
        }
        #[unroll]
        for k in 0usize..3usize {
            gradient[k * all + i] = exposure[k] * g0 + exposure[4 + k] * g1 + exposure[8 + k] * g2;
        }
    }
    if comptime!(log) {
        write_parts(&share, parts, 12usize);
    }
}

impl GpuTrainer {
    /// Renders each view of a frame, by its number, and adds up the sums for the fit of colours; on
    /// the device, read back at the end. Ends where `stop` says so before a frame: the sums are
    /// then of no use. Fails with [`GpuError`] if there is no such frame, if there is no room for
    /// the tile entries, or if the device failed.
    pub fn colour_sums(
        &mut self,
        views: &[(usize, View)],
        with_weight: bool,
        stop: &dyn Fn() -> bool,
    ) -> Result<ColourSums, GpuError> {
        let (n, gpu) = (self.splats.n, self.gpu.clone());
        let kinds = if with_weight { 2 } else { 1 };
        let sums = Buffer::zeros(&gpu.client, 3 * kinds * n);
        for (frame, view) in views {
            if stop() {
                break;
            }
            self.draw(view)?;
            let target = self.frames.get(&gpu, *frame)?;
            let (shown, exposure) = self.corrected(*frame);
            self.leave_residual(&shown, &target);
            if let Some(exposure) = exposure {
                self.pull_back(*frame, &exposure, false);
            }
            self.add_colours(view, &sums, 0);
            if with_weight {
                let ones = 3 * self.work.size.pixels();
                launch!(
                    &gpu.client,
                    fill_ones::launch,
                    (cubes(ones, 256), units()),
                    [self.work.gradient],
                    [ones as u32]
                );
                self.add_colours(view, &sums, 3 * n);
            }
        }
        let sums = sums.read_floats(&gpu.client, TRAINING)?;
        let planes = |kind: usize| [0, 1, 2].map(|k| sums[(3 * kind + k) * n..][..n].to_vec());
        Ok(ColourSums {
            residual: planes(0),
            weight: if with_weight {
                planes(1)
            } else {
                Default::default()
            },
        })
    }

    /// Image minus frame becomes the gradient.
    fn leave_residual(&self, shown: &Buffer, frame: &Buffer) {
        let pixels = self.work.size.pixels();
        launch!(
            &self.gpu.client,
            residual::launch,
            (cubes(pixels, 256), units()),
            [shown, frame, self.work.gradient],
            [pixels as u32]
        );
    }

    /// Adds the gradient of the constant coefficients to three planes of `sums`.
    fn add_colours(&mut self, view: &View, sums: &Buffer, first: usize) {
        let n = self.splats.n;
        self.work.backward(
            &self.gpu,
            &self.splats,
            &self.gradients,
            view.mip,
            None,
            None,
        );
        launch!(
            &self.gpu.client,
            add_touched::launch,
            (cubes(n, 256), units()),
            [
                self.gradients.colour,
                self.work.touched,
                self.adam.steps,
                sums
            ],
            [n as u32, first as u32]
        );
    }
}

/// Image minus frame.
#[cube(launch)]
fn residual(image: &[f32], target: &[u32], gradient: &mut [f32], pixels: u32) {
    let i = ABSOLUTE_POS as u32;
    if i < pixels {
        #[unroll]
        for channel in 0u32..3u32 {
            let at = (channel * pixels + i) as usize;
            gradient[at] = image[at] - target_at(target, i, channel, pixels);
        }
    }
}

#[cube(launch)]
fn fill_ones(values: &mut [f32], count: u32) {
    if ABSOLUTE_POS < count as usize {
        values[ABSOLUTE_POS] = f32::new(1.0f32);
    }
}

/// Adds three columns to three planes, where touched and not fixed.
#[cube(launch)]
fn add_touched(
    columns: &[f32],
    touched: &[u32],
    steps: &[u32],
    sums: &mut [f32],
    n: u32,
    first: u32,
) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        if touched[i as usize] != 0u32 && steps[i as usize] != FIXED {
            for k in 0u32..3u32 {
                let at = k * n + i;
                sums[(first + at) as usize] += columns[at as usize];
            }
        }
    }
}
