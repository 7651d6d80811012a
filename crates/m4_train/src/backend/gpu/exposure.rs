//! Colour corrections of frames: applied to the rendering before the comparison, and their gradient.

use super::GpuTrainer;
use cubecl::prelude::*;
use m4_core::Exposure;
use m4_kernels::gpu::Gpu;
use m4_kernels::gpu::buffer::{Buffer, cubes, units};
use m4_kernels::gpu::log::write_parts;

/// Of an exposure: rows of the matrix, each followed by its offset.
pub(crate) const NUMBERS: usize = 12;

impl GpuTrainer {
    /// The correction of each frame from here on, by number: steps, scores and sums of colours compare `matrix rgb +
    /// offset` with the frame. Frames that the list does not reach, all of them for an empty one, are not corrected.
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
        expose::launch(
            client,
            cubes(pixels, 256),
            units(),
            self.work.image.arg(),
            exposure.arg(),
            self.exposed.arg(),
            pixels as u32,
        );
        (self.exposed.clone(), Some(exposure))
    }

    /// Turns the gradient of corrected colours into that of the colours drawn; `log` also keeps that of the correction.
    pub(crate) fn pull_back(&mut self, frame: usize, exposure: &Buffer, log: bool) {
        let (gpu, pixels) = (&self.gpu, self.work.size.pixels());
        let parts = log.then(|| self.exposure_log.next(gpu, frame, pixels));
        pull_back::launch(
            &gpu.client,
            cubes(pixels, 256),
            units(),
            self.work.image.arg(),
            exposure.arg(),
            self.work.gradient.arg(),
            // any other memory where nothing is written
            parts.as_ref().unwrap_or(&self.exposed).arg(),
            pixels as u32,
            log,
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
            out[r * all + i] =
                exposure[4 * r] * red + exposure[4 * r + 1] * green + exposure[4 * r + 2] * blue + exposure[4 * r + 3];
        }
    }
}

/// `gradient` becomes the matrix's transpose times itself; `parts` get the gradient of the correction, summed a cube.
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
