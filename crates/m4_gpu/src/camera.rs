//! The gradient with respect to the camera: a sum over the splats, a row of ten numbers a look.

use crate::buffer::{Buffer, cubes, units};
use crate::photo::cube_sum;
use crate::{Gpu, GpuError};
use cubecl::prelude::*;
use m4_kernels::CameraGradient;

/// Translation and rotation of the left twist, focal lengths, principal point.
pub(crate) const NUMBERS: usize = 10;
/// Looks of a page.
const PAGE: usize = 256;

/// Gradients of cameras since they were asked for the last time, in the order of the looks.
#[derive(Debug, Default)]
pub(crate) struct Cameras {
    frames: Vec<usize>,
    /// Rows of as many looks each.
    pages: Vec<Buffer>,
    /// Sums of the cubes of the look drawn last, and their number.
    parts: Option<(Buffer, usize)>,
}

impl Cameras {
    /// Memory for a look at frame `frame` of `n` splats: ten numbers for each cube of 256 of them.
    pub fn next(&mut self, gpu: &Gpu, frame: usize, n: usize) -> Buffer {
        if self.frames.len() == self.pages.len() * PAGE {
            self.pages.push(Buffer::empty(&gpu.client, NUMBERS * PAGE));
        }
        self.frames.push(frame);
        let count = n.div_ceil(256).max(1);
        let parts = match self.parts.take() {
            Some((buffer, old)) if old == count => buffer,
            _ => Buffer::empty(&gpu.client, NUMBERS * count),
        };
        self.parts = Some((parts.clone(), count));
        parts
    }

    /// The sums of the cubes become the row of the look made last.
    pub fn add_up(&self, gpu: &Gpu) {
        let (Some((parts, count)), Some(page), Some(look)) =
            (&self.parts, self.pages.last(), self.frames.len().checked_sub(1))
        else {
            return;
        };
        add_up::launch(
            &gpu.client,
            cubes(1, 1),
            units(),
            parts.arg(),
            page.arg(),
            *count as u32,
            (look % PAGE) as u32,
        );
    }

    /// Waits, and hands out frames and gradients in the order of the looks.
    pub fn take(&mut self, gpu: &Gpu, doing: &'static str) -> Result<Vec<(usize, CameraGradient)>, GpuError> {
        let frames = std::mem::take(&mut self.frames);
        let mut rows = Vec::new();
        for page in self.pages.drain(..) {
            rows.extend(page.read_floats(&gpu.client, doing)?);
        }
        let gradients = rows.as_chunks::<NUMBERS>().0.iter().map(|row| {
            let row = row.map(f64::from);
            CameraGradient {
                tau: [row[0], row[1], row[2]],
                omega: [row[3], row[4], row[5]],
                intrinsics: [row[6], row[7], row[8], row[9]],
            }
        });
        Ok(frames.into_iter().zip(gradients).collect())
    }
}

/// Writes the ten sums of a cube of 256 units; each unit brings its own share.
#[cube]
pub(crate) fn write_parts(share: &Array<f32>, parts: &mut [f32]) {
    let mut shared = Shared::<[f32]>::new_slice(256usize);
    #[unroll]
    for k in 0usize..10usize {
        let sum = cube_sum(share[k], &mut shared);
        let at = CUBE_POS * 10 + k;
        if UNIT_POS == 0u32 && at < parts.len() {
            parts[at] = sum;
        }
    }
}

#[cube(launch)]
fn add_up(parts: &[f32], rows: &mut [f32], count: u32, look: u32) {
    let mut shared = Shared::<[f32]>::new_slice(256usize);
    #[unroll]
    for k in 0u32..10u32 {
        let mut mine = 0.0f32;
        let mut cube = UNIT_POS;
        while cube < count {
            mine += parts[(cube * 10u32 + k) as usize];
            cube += 256u32;
        }
        let sum = cube_sum(mine, &mut shared);
        if UNIT_POS == 0u32 {
            rows[(look * 10u32 + k) as usize] = sum;
        }
    }
}
