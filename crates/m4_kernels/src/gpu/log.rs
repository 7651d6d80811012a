//! Gradients of a frame's camera and exposure: one row of numbers per view, kept on the device
//! until the host reads them.

#![expect(
    missing_docs,
    reason = "`cube` generates items beside those that it is written at"
)]

use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::scan::cube_sum;
use crate::gpu::{Gpu, GpuError};
use crate::launch;
use cubecl::prelude::*;

/// Views per page.
const PAGE: usize = 256;

/// Rows of `N` numbers since they were asked for the last time, in the order of the views.
#[derive(Debug, Default)]
pub struct Log<const N: usize> {
    frames: Vec<usize>,
    /// Rows of as many views each.
    pages: Vec<Buffer>,
    /// Sums of the cubes of the last view, and their number.
    parts: Option<(Buffer, usize)>,
}

impl<const N: usize> Log<N> {
    /// Memory for a view of frame `frame`: `N` sums for each cube of 256 of `n` things.
    /// [`add_up`](Self::add_up) comes after they are written.
    pub fn next(&mut self, gpu: &Gpu, frame: usize, n: usize) -> Buffer {
        if self.frames.len() == self.pages.len() * PAGE {
            self.pages.push(Buffer::empty(&gpu.client, N * PAGE));
        }
        self.frames.push(frame);
        let count = n.div_ceil(256).max(1);
        let parts = match self.parts.take() {
            Some((buffer, old)) if old == count => buffer,
            _ => Buffer::empty(&gpu.client, N * count),
        };
        self.parts = Some((parts.clone(), count));
        parts
    }

    /// The sums of the cubes become the row of the last view.
    pub fn add_up(&self, gpu: &Gpu) {
        let (Some((parts, count)), Some(page), Some(view)) = (
            &self.parts,
            self.pages.last(),
            self.frames.len().checked_sub(1),
        ) else {
            return;
        };
        launch!(
            &gpu.client,
            add_up::launch,
            (cubes(1, 1), units()),
            [parts, page],
            [*count as u32, (view % PAGE) as u32, N as u32]
        );
    }

    /// Waits, and returns frames and rows in the order of the views. Fails with [`GpuError`] if the
    /// device failed.
    pub fn take(
        &mut self,
        gpu: &Gpu,
        doing: &'static str,
    ) -> Result<Vec<(usize, [f64; N])>, GpuError> {
        let frames = std::mem::take(&mut self.frames);
        let mut values = Vec::new();
        for page in self.pages.drain(..) {
            values.extend(page.read_floats(&gpu.client, doing)?);
        }
        let rows = values
            .as_chunks::<N>()
            .0
            .iter()
            .map(|row| row.map(f64::from));
        Ok(frames.into_iter().zip(rows).collect())
    }
}

/// Writes the sums of a cube of 256 units; each unit adds its own share. No unit may have returned
/// before.
#[cube]
pub fn write_parts(share: &Array<f32>, parts: &mut [f32], #[comptime] numbers: usize) {
    let mut shared = Shared::<[f32]>::new_slice(256usize);
    #[unroll]
    for k in 0usize..numbers {
        let sum = cube_sum(share[k], &mut shared);
        let at = CUBE_POS * numbers + k;
        if UNIT_POS == 0u32 && at < parts.len() {
            parts[at] = sum;
        }
    }
}

#[cube(launch)]
fn add_up(parts: &[f32], rows: &mut [f32], count: u32, view: u32, #[comptime] numbers: u32) {
    let mut shared = Shared::<[f32]>::new_slice(256usize);
    #[unroll]
    for k in 0u32..numbers {
        let mut mine = 0.0f32;
        let mut cube = UNIT_POS;
        while cube < count {
            mine += parts[(cube * numbers + k) as usize];
            cube += 256u32;
        }
        let sum = cube_sum(mine, &mut shared);
        if UNIT_POS == 0u32 {
            rows[(view * numbers + k) as usize] = sum;
        }
    }
}
