//! A picture against a frame: sums for what is reported, and the gradient.

use crate::Gpu;
use crate::buffer::{Buffer, cubes, units};
use crate::found::{BAD_LOSS, DEPTH, Tally, add_float, is_finite};
use crate::frames::{DeviceDepth, DeviceFrame};
use crate::photo::{self, cube_sum};
use crate::step::DepthTerm;
use crate::work::Size;
use cubecl::prelude::*;

/// Memory for frames of one size.
#[derive(Debug)]
pub(crate) struct Loss {
    size: Size,
    /// SSIM's derivatives, three planes a channel.
    slopes: Buffer,
    /// Three sums a tile and channel.
    sums: Buffer,
}

impl Loss {
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

    /// Compares `image` with `frame`, which is number `index`, and adds what it finds to `tally`. `lambda` is the share of
    /// SSIM.
    pub fn compare(&self, gpu: &Gpu, image: &Buffer, frame: &DeviceFrame, index: usize, lambda: f32, tally: &Tally) {
        photo::similarity::launch(
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
        tally.look(
            gpu,
            &self.sums,
            self.size.tiles(),
            3 * self.size.pixels(),
            index,
            lambda,
        );
    }

    /// The gradient of what was compared last, with respect to `image`.
    pub fn gradient(&self, gpu: &Gpu, image: &Buffer, frame: &DeviceFrame, lambda: f32, out: &Buffer) {
        photo::gradient::launch(
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

    /// Adds the depth term to `tally`, and its gradient to `out`: planes of alpha and depth.
    pub fn depth(&self, gpu: &Gpu, image: &Buffer, depth: &DeviceDepth, term: DepthTerm, out: &Buffer, tally: &Tally) {
        let pixels = self.size.pixels();
        // nine numbers a tile of 256 pixels: there is room for one
        depth_gradient::launch(
            &gpu.client,
            cubes(pixels, 256),
            units(),
            image.arg(),
            depth.z.arg(),
            out.arg(),
            self.sums.arg(),
            pixels as u32,
            term.weight,
            term.huber,
            term.alpha_weight,
            1.0 / depth.known.max(1) as f32,
        );
        add_depth::launch(
            &gpu.client,
            cubes(1, 1),
            units(),
            self.sums.arg(),
            tally.buffer.arg(),
            pixels.div_ceil(256) as u32,
            1.0 / depth.known.max(1) as f32,
        );
    }
}

/// The gradient with respect to alpha and depth, and the sum of the loss a cube.
#[cube(launch)]
fn depth_gradient(
    image: &[f32],
    depth: &[u32],
    gradient: &mut [f32],
    sums: &mut [f32],
    pixels: u32,
    weight: f32,
    huber: f32,
    alpha_weight: f32,
    per_pixel: f32,
) {
    let mut shared = Shared::<[f32]>::new_slice(256usize);
    let i = ABSOLUTE_POS as u32;
    let mut loss = 0.0f32;
    if i < pixels {
        let z = f32::reinterpret(depth[i as usize]);
        let mut d_depth = 0.0f32;
        let mut d_alpha = 0.0f32;
        if is_finite(z) && z > 0.0f32 {
            let light = image[(3u32 * pixels + i) as usize];
            let r = (image[(4u32 * pixels + i) as usize] - z * (1.0f32 - light)) / z;
            let mut value = r.abs() - 0.5f32 * huber;
            let mut slope = f32::new(1.0f32);
            if r < 0.0f32 {
                slope = f32::new(-1.0f32);
            }
            if r.abs() < huber {
                value = 0.5f32 * r * r / huber;
                slope = r / huber;
            }
            loss = weight * value + alpha_weight * light;
            d_depth = weight * slope * per_pixel / z;
            d_alpha = -(weight * slope + alpha_weight) * per_pixel;
        }
        gradient[(3u32 * pixels + i) as usize] = d_alpha;
        gradient[(4u32 * pixels + i) as usize] = d_depth;
    }
    let loss = cube_sum(loss, &mut shared);
    if UNIT_POS == 0u32 && CUBE_POS < sums.len() {
        sums[CUBE_POS] = loss;
    }
}

#[cube(launch)]
fn add_depth(sums: &[f32], tally: &mut [u32], count: u32, per_pixel: f32) {
    let mut shared = Shared::<[f32]>::new_slice(256usize);
    let mut mine = 0.0f32;
    let mut k = UNIT_POS;
    while k < count {
        mine += sums[k as usize];
        k += 256u32;
    }
    let loss = cube_sum(mine, &mut shared) * per_pixel;
    if UNIT_POS == 0u32 {
        add_float(tally, DEPTH, loss);
        if !is_finite(loss) {
            tally[BAD_LOSS] = 1u32;
        }
    }
}
