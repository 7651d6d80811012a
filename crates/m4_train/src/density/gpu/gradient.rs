//! The statistic that 3DGS densifies by, collected on the device as [`crate::density::gradient`]
//! does it on the CPU.

use cubecl::prelude::*;
use m4_kernels::launch;
use m4_kernels::{
    adam::{FIXED, gpu::DeviceAdam},
    gpu::{
        Gpu,
        buffer::{Buffer, cubes, units},
    },
    renderer::gpu::Work,
    splats::gathered_words,
};

/// Gradients with respect to the centres of splats in the image, and their sums over frames.
#[derive(Debug)]
pub(crate) struct ImageGradients {
    n: usize,
    /// Of the last frame, `[2][n]`; rows that it did not touch hold anything.
    centres: Buffer,
    /// Sums of the lengths, `[n]`.
    sums: Buffer,
    /// Frames that touched a splat, `[n]`.
    frames: Buffer,
}

impl ImageGradients {
    /// Of `n` splats, none of which was seen.
    pub(crate) fn new(gpu: &Gpu, n: usize) -> Self {
        let client = &gpu.client;
        Self {
            n,
            centres: Buffer::empty(client, 2 * n),
            sums: Buffer::zeros(client, n),
            frames: Buffer::zeros(client, n),
        }
    }

    /// Where a frame of `n` splats leaves the gradients of the centres.
    pub(crate) fn centres(&mut self, gpu: &Gpu, n: usize) -> &Buffer {
        self.fit(gpu, n);
        &self.centres
    }

    /// Adds the frame whose gradients `work` and [`centres`](Self::centres) have, where it touched
    /// splats that are not fixed.
    pub(crate) fn add(&self, gpu: &Gpu, work: &Work, adam: &DeviceAdam) {
        launch!(
            &gpu.client,
            add_lengths::launch,
            (cubes(self.n, 256), units()),
            [
                self.centres,
                work.touched,
                adam.steps,
                self.sums,
                self.frames
            ],
            [
                self.n as u32,
                0.5 * work.size.width as f32,
                0.5 * work.size.height as f32
            ]
        );
    }

    /// The means as the scores of `n` splats, `[2][n]`, none of which is pruned by score; the sums
    /// start anew.
    pub(crate) fn take(&mut self, gpu: &Gpu, n: usize) -> Buffer {
        let scores = self.means(gpu, n);
        self.sums.clear(&gpu.client);
        self.frames.clear(&gpu.client);
        scores
    }

    /// The means as scores, `[2][n]`; the sums go on.
    pub(crate) fn means(&mut self, gpu: &Gpu, n: usize) -> Buffer {
        self.fit(gpu, n);
        let scores = Buffer::zeros(&gpu.client, 2 * n);
        launch!(
            &gpu.client,
            means::launch,
            (cubes(n, 256), units()),
            [self.sums, self.frames, scores],
            [n as u32]
        );
        scores
    }

    /// Follows `n` splats that were laid out again.
    pub(crate) fn rearrange(&mut self, gpu: &Gpu, rows: &Buffer, n: usize) {
        self.fit(gpu, n);
        self.sums = gathered_words(gpu, &self.sums, rows, n);
        self.frames = gathered_words(gpu, &self.frames, rows, n);
    }

    /// Starts anew where there are other splats than before.
    fn fit(&mut self, gpu: &Gpu, n: usize) {
        if self.n != n {
            *self = Self::new(gpu, n);
        }
    }
}

/// Adds the length of a gradient in units of half the image (docs/spec/optimiser.md 1.7).
#[cube(launch)]
fn add_lengths(
    centres: &[f32],
    touched: &[u32],
    steps: &[u32],
    sums: &mut [f32],
    frames: &mut [u32],
    n: u32,
    half_width: f32,
    half_height: f32,
) {
    let i = ABSOLUTE_POS;
    let all = n as usize;
    if i < all {
        let counts = touched[i] != 0u32 && steps[i] != FIXED;
        if counts {
            let x = centres[i] * half_width;
            let y = centres[all + i] * half_height;
            sums[i] += (x * x + y * y).sqrt();
            frames[i] += 1u32;
        }
    }
}

#[cube(launch)]
fn means(sums: &[f32], frames: &[u32], scores: &mut [f32], n: u32) {
    let i = ABSOLUTE_POS;
    if i < n as usize {
        scores[i] = sums[i] / f32::cast_from(frames[i].max(1u32));
    }
}
