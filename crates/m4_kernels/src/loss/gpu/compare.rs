//! Compares an image with a frame: sums for statistics, and the gradient.

use crate::gpu::Gpu;
use crate::gpu::buffer::{Buffer, units};
use crate::gpu::frames::DeviceFrame;
use crate::gpu::tally::Tally;
use crate::gpu::work::Size;
use cubecl::prelude::*;

/// Memory for frames of one size.
#[derive(Debug)]
pub struct Loss {
    size: Size,
    /// SSIM's derivatives, three planes per channel.
    slopes: Buffer,
    /// Three sums per tile and channel.
    sums: Buffer,
}

impl Loss {
    /// Memory for frames of `size`.
    #[must_use]
    pub fn new(gpu: &Gpu, size: Size) -> Self {
        Self {
            size,
            slopes: Buffer::empty(&gpu.client, 9 * size.pixels()),
            sums: Buffer::empty(&gpu.client, 9 * size.tiles()),
        }
    }

    /// A cube a tile and channel.
    fn cubes(&self) -> CubeCount {
        CubeCount::Static(self.size.tiles() as u32, 3, 1)
    }

    /// Compares `image` with `frame` and adds the sums to `tally`, the loss as that of view `index`. `lambda` is the share of
    /// SSIM.
    pub fn compare(&self, gpu: &Gpu, image: &Buffer, frame: &DeviceFrame, index: usize, lambda: f32, tally: &Tally) {
        super::similarity::launch(
            &gpu.client,
            self.cubes(),
            units(),
            image.arg(),
            frame.samples.arg(),
            self.slopes.arg(),
            self.sums.arg(),
            self.size.width as u32,
            self.size.height as u32,
            frame.worth,
            frame.wide,
        );
        tally.frame(gpu, &self.sums, self.size.tiles(), 3 * self.size.pixels(), index, lambda);
    }

    /// The gradient of what was compared last, with respect to `image`.
    pub fn gradient(&self, gpu: &Gpu, image: &Buffer, frame: &DeviceFrame, lambda: f32, out: &Buffer) {
        super::gradient::launch(
            &gpu.client,
            self.cubes(),
            units(),
            image.arg(),
            frame.samples.arg(),
            self.slopes.arg(),
            out.arg(),
            self.size.width as u32,
            self.size.height as u32,
            lambda,
            frame.worth,
            frame.wide,
        );
    }
}
