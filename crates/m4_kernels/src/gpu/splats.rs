//! Splats on the device.

use crate::gpu::buffer::Buffer;
use crate::gpu::{Gpu, GpuError};
use crate::project::gpu::Spec;
use m4_core::{Column, SplatLayout, Splats};
use std::ops::Range;

/// Columns of splats, or numbers for each of them, in three buffers of whole columns one after the other: geometry with
/// opacity, colours, and what dynamic splats have besides.
#[derive(Debug, Clone)]
pub struct DeviceSplats {
    /// Mean, scale, rotation, opacity.
    pub geometry: Buffer,
    /// Coefficients of the colours.
    pub colour: Buffer,
    /// Of dynamic splats only.
    pub time: Buffer,
    /// The columns.
    pub layout: SplatLayout,
    /// Splats.
    pub n: usize,
    /// Static ones among them, the first rows.
    pub n_static: usize,
}

/// The columns of each buffer.
#[must_use]
pub fn parts(layout: SplatLayout) -> [Range<usize>; 3] {
    let colour = layout.range(Column::Colour);
    [0..colour.start, colour, layout.shared_columns()..layout.columns()]
}

impl DeviceSplats {
    /// Geometry, colours, time.
    #[must_use]
    pub fn buffers(&self) -> [&Buffer; 3] {
        [&self.geometry, &self.colour, &self.time]
    }

    /// Copies `splats` to the device.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if they do not fit.
    pub fn upload(gpu: &Gpu, splats: &Splats) -> Result<Self, GpuError> {
        let [geometry, colour, time] = parts(splats.layout()).map(|range| splats.columns()[range].concat());
        for (what, len) in [("the geometry of the splats", geometry.len()), ("the colours of the splats", colour.len())]
        {
            gpu.fits(what, 4 * len)?;
        }
        Ok(Self {
            geometry: Buffer::floats(&gpu.client, &geometry),
            colour: Buffer::floats(&gpu.client, &colour),
            time: Buffer::floats(&gpu.client, &time),
            layout: splats.layout(),
            n: splats.n(),
            n_static: splats.n_static(),
        })
    }

    /// Room for as many numbers as `self` has; they are anything.
    #[must_use]
    pub fn like(&self, gpu: &Gpu) -> Self {
        let empty = |buffer: &Buffer| Buffer::empty(&gpu.client, buffer.len());
        Self { geometry: empty(&self.geometry), colour: empty(&self.colour), time: empty(&self.time), ..self.clone() }
    }

    /// Waits, and copies them back.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed.
    pub fn download(&self, gpu: &Gpu, doing: &'static str) -> Result<Splats, GpuError> {
        let mut out = Splats::zeros(self.layout, self.n_static, self.n - self.n_static);
        let mut columns: Vec<&mut [f32]> = out.columns_mut().collect();
        for (buffer, range) in self.buffers().into_iter().zip(parts(self.layout)) {
            let values = buffer.read_floats(&gpu.client, doing)?;
            let mut rest = values.as_slice();
            for column in &mut columns[range] {
                let (here, after) = rest.split_at(column.len());
                column.copy_from_slice(here);
                rest = after;
            }
        }
        Ok(out)
    }

    /// What the kernels are compiled for.
    pub(crate) fn spec(&self, mip: bool) -> Spec {
        Spec {
            isotropic: self.layout.isotropic,
            sh_terms: self.layout.sh_terms() as u32,
            time_terms: self.layout.time_degree as u32 + 1,
            mip,
        }
    }
}
