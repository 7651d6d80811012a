//! The sums for the least-squares fit of colours: the residual of a splat's pixels, and the weight of the splat in them.
#![expect(clippy::collapsible_if, reason = "kernels are expanded: conditions at compile time stand alone")]

use crate::backend::{
    ColourSums,
    gpu::{GpuTrainer, trainer::TRAINING},
};
use cubecl::prelude::*;
use m4_kernels::{
    View,
    gpu::{
        GpuError,
        buffer::{Buffer, cubes, units},
    },
    loss::gpu::target_at,
};

impl GpuTrainer {
    /// Renders each view of a frame, by its number, and adds up the sums for the fit of colours; on the device,
    /// read back at the end.
    /// Fails with [`GpuError`] if there is no such frame, if there is no room for the tile entries, or if the device failed.
    pub fn colour_sums(&mut self, views: &[(usize, View)], with_weight: bool) -> Result<ColourSums, GpuError> {
        let (n, gpu) = (self.splats.n, self.gpu.clone());
        let kinds = if with_weight { 2 } else { 1 };
        let sums = Buffer::zeros(&gpu.client, 3 * kinds * n);
        for (frame, view) in views {
            self.draw(view)?;
            let target = self.frames.get(&gpu, *frame)?;
            self.leave_residual(&target);
            self.add_colours(view, &sums, 0);
            if with_weight {
                let ones = 3 * self.work.size.pixels();
                fill_ones::launch(&gpu.client, cubes(ones, 256), units(), self.work.gradient.arg(), ones as u32);
                self.add_colours(view, &sums, 3 * n);
            }
        }
        let sums = sums.read_floats(&gpu.client, TRAINING)?;
        let planes = |kind: usize| [0, 1, 2].map(|k| sums[(3 * kind + k) * n..][..n].to_vec());
        Ok(ColourSums { residual: planes(0), weight: if with_weight { planes(1) } else { Default::default() } })
    }

    /// Image minus frame becomes the gradient.
    fn leave_residual(&self, frame: &Buffer) {
        let pixels = self.work.size.pixels();
        residual::launch(
            &self.gpu.client,
            cubes(pixels, 256),
            units(),
            self.work.image.arg(),
            frame.arg(),
            self.work.gradient.arg(),
            pixels as u32,
        );
    }

    /// Adds the gradient of the constant coefficients to three planes of `sums`.
    fn add_colours(&mut self, view: &View, sums: &Buffer, first: usize) {
        let n = self.splats.n;
        self.work.backward(&self.gpu, &self.splats, &self.gradients, view.mip);
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
