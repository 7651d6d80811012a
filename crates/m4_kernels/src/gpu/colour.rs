//! Sums for the least-squares fit of colours: the residual of a splat's pixels, and the weight of the splat in them.

use crate::View;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::frames::DeviceFrame;
use crate::gpu::trainer::TRAINING;
use crate::gpu::{GpuError, Trainer};
use crate::loss::gpu::{cube_sum, target_at};
use crate::tile_binning::gpu as tile_binning;
use cubecl::prelude::*;

/// Sums over the pixels of some frames, as derivatives with respect to the constant coefficient of each colour:
/// `[channel][n]`, 0 where a splat was not seen.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ColourSums {
    /// Of blending weight times image minus frame.
    pub residual: [Vec<f32>; 3],
    /// Of blending weights; empty unless they were asked for.
    pub weight: [Vec<f32>; 3],
    /// Sum of squared differences between images and frames over channels and pixels.
    pub squares: f64,
}

impl Trainer {
    /// Draws each look, frame by number and how it is seen, and adds up what the fit of colours needs; on the device,
    /// read back at the end.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if there is no such frame, if there is no room for the tile entries, or if the device failed.
    pub fn colour_gradient(&mut self, looks: &[(usize, View)], with_weight: bool) -> Result<ColourSums, GpuError> {
        let (n, gpu) = (self.splats.n, self.gpu.clone());
        let kinds = if with_weight { 2 } else { 1 };
        let sums = Buffer::empty(&gpu.client, 3 * kinds * n);
        tile_binning::clear::launch(&gpu.client, cubes(3 * kinds * n, 256), units(), sums.arg());
        let squares = Buffer::empty(&gpu.client, looks.len());
        let parts = Buffer::empty(&gpu.client, self.work.size.pixels().div_ceil(256));
        for (look, (frame, view)) in looks.iter().enumerate() {
            self.draw(view)?;
            let target = self.frames.get(&gpu, *frame)?;
            let (shown, exposure) = self.corrected(*frame);
            self.leave_residual(&shown, &target, &parts, &squares, look);
            if let Some(exposure) = exposure {
                self.pull_back(*frame, &exposure, false);
            }
            self.add_colours(view, &sums, 0);
            if with_weight {
                let ones = 3 * self.work.size.pixels();
                fill_ones::launch(
                    &gpu.client,
                    cubes(ones, 256),
                    units(),
                    self.work.gradient.arg(),
                    ones as u32,
                );
                self.add_colours(view, &sums, 3 * n);
            }
        }
        let sums = sums.read_floats(&gpu.client, TRAINING)?;
        let squares = squares.read_floats(&gpu.client, TRAINING)?;
        let planes = |kind: usize| [0, 1, 2].map(|k| sums[(3 * kind + k) * n..][..n].to_vec());
        Ok(ColourSums {
            residual: planes(0),
            weight: if with_weight { planes(1) } else { Default::default() },
            squares: squares[..looks.len()].iter().map(|&s| f64::from(s)).sum(),
        })
    }

    /// Image minus frame becomes the gradient.
    fn leave_residual(&self, shown: &Buffer, frame: &DeviceFrame, parts: &Buffer, squares: &Buffer, look: usize) {
        let (client, pixels) = (&self.gpu.client, self.work.size.pixels());
        residual::launch(
            client,
            cubes(pixels, 256),
            units(),
            shown.arg(),
            frame.samples.arg(),
            self.work.gradient.arg(),
            parts.arg(),
            pixels as u32,
            frame.worth,
            frame.wide,
        );
        add_parts::launch(
            client,
            cubes(1, 1),
            units(),
            parts.arg(),
            squares.arg(),
            pixels.div_ceil(256) as u32,
            look as u32,
        );
    }

    /// Adds the gradient of the constant coefficients to three planes of `sums`.
    fn add_colours(&mut self, view: &View, sums: &Buffer, first: usize) {
        let n = self.splats.n;
        self.work
            .backward(&self.gpu, &self.splats, &self.gradients, view.mip, false, false, None);
        add_touched::launch(
            &self.gpu.client,
            cubes(n, 256),
            units(),
            self.gradients.colour.arg(),
            self.work.touched.arg(),
            sums.arg(),
            n as u32,
            first as u32,
        );
    }
}

/// Image minus frame, and the sum of its squares a cube.
#[cube(launch)]
fn residual(
    image: &[f32],
    target: &[u32],
    gradient: &mut [f32],
    parts: &mut [f32],
    pixels: u32,
    worth: f32,
    #[comptime] wide: bool,
) {
    let mut shared = Shared::<[f32]>::new_slice(256usize);
    let i = ABSOLUTE_POS as u32;
    let mut squares = 0.0f32;
    if i < pixels {
        #[unroll]
        for channel in 0u32..3u32 {
            let at = (channel * pixels + i) as usize;
            let difference = image[at] - target_at(target, i, channel, pixels, worth, wide);
            gradient[at] = difference;
            squares += difference * difference;
        }
    }
    let squares = cube_sum(squares, &mut shared);
    if UNIT_POS == 0u32 && CUBE_POS < parts.len() {
        parts[CUBE_POS] = squares;
    }
}

#[cube(launch)]
fn add_parts(parts: &[f32], sums: &mut [f32], count: u32, at: u32) {
    let mut shared = Shared::<[f32]>::new_slice(256usize);
    let mut mine = 0.0f32;
    let mut k = UNIT_POS;
    while k < count {
        mine += parts[k as usize];
        k += 256u32;
    }
    let sum = cube_sum(mine, &mut shared);
    if UNIT_POS == 0u32 {
        sums[at as usize] = sum;
    }
}

#[cube(launch)]
fn fill_ones(values: &mut [f32], count: u32) {
    if ABSOLUTE_POS < count as usize {
        values[ABSOLUTE_POS] = f32::new(1.0f32);
    }
}

/// Adds three columns to three planes, where touched.
#[cube(launch)]
fn add_touched(columns: &[f32], touched: &[u32], sums: &mut [f32], n: u32, first: u32) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        if touched[i as usize] != 0u32 {
            for k in 0u32..3u32 {
                let at = k * n + i;
                sums[(first + at) as usize] += columns[at as usize];
            }
        }
    }
}
