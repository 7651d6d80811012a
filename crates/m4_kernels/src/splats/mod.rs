//! Splats on the device with what carries the bound ones, the gather of their rows into a new
//! order, and the order of memory.

mod bound;
mod lists;
mod morton;

pub use bound::Bound;
pub(crate) use bound::{LIFE, MOTION, NODE, POSE, WEIGHT};
pub use morton::morton_order;

use crate::gpu::buffer::{Buffer, NOTHING, cubes, units};
use crate::gpu::{Gpu, GpuError};
use crate::launch;
use cubecl::prelude::*;
use m4_core::{Column, SplatLayout, Splats};
use std::ops::Range;

/// Columns of splats, or numbers for each of them, in three buffers of whole columns one after the
/// other: geometry with opacity, colours, and what dynamic splats have besides.
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
    /// Windows, where there are some, and what binds the rows that follow to them.
    pub bound: Option<Bound>,
}

/// The columns of each buffer.
pub fn parts(layout: SplatLayout) -> [Range<usize>; 3] {
    let colour = layout.range(Column::Colour);
    [
        0..colour.start,
        colour,
        layout.shared_columns()..layout.columns(),
    ]
}

impl DeviceSplats {
    /// Geometry, colours, time.
    pub fn buffers(&self) -> [&Buffer; 3] {
        [&self.geometry, &self.colour, &self.time]
    }

    /// Copies `splats` to the device. Fails with [`GpuError`] if they do not fit.
    pub fn upload(gpu: &Gpu, splats: &Splats) -> Result<Self, GpuError> {
        let [geometry, colour, time] =
            parts(splats.layout()).map(|range| splats.columns()[range].concat());
        for (what, len) in [
            ("the geometry of the splats", geometry.len()),
            ("the colours of the splats", colour.len()),
        ] {
            gpu.fits(what, 4 * len)?;
        }
        Ok(Self {
            geometry: Buffer::floats(&gpu.client, &geometry),
            colour: Buffer::floats(&gpu.client, &colour),
            time: Buffer::floats(&gpu.client, &time),
            layout: splats.layout(),
            n: splats.n(),
            n_static: splats.n_static(),
            bound: Bound::upload(gpu, splats)?,
        })
    }

    /// Room for as many numbers as `self` has; they are anything.
    pub fn like(&self, gpu: &Gpu) -> Self {
        let empty = |buffer: &Buffer| Buffer::empty(&gpu.client, buffer.len());
        Self {
            geometry: empty(&self.geometry),
            colour: empty(&self.colour),
            time: empty(&self.time),
            bound: None,
            ..*self
        }
    }

    /// Waits, and copies them back. Fails with [`GpuError`] if the device failed.
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
        drop(columns);
        if let Some(bound) = &self.bound {
            bound.download(gpu, &mut out, doing)?;
        }
        Ok(out)
    }

    /// Splats that are drawn as static ones are: those and the bound ones, which follow.
    pub fn n_still(&self) -> usize {
        self.n_static + self.bound.as_ref().map_or(0, |bound| bound.n)
    }

    /// What is drawn of bound splats; any other memory where there are none.
    pub(crate) fn posed<'a>(&'a self, other: &'a Buffer) -> &'a Buffer {
        self.bound.as_ref().map_or(other, Bound::posed)
    }
}

/// The numbers of `from` that `rows` names, one per splat: `n` of them, 0 for [`NOTHING`].
pub fn gathered_words(gpu: &Gpu, from: &Buffer, rows: &Buffer, n: usize) -> Buffer {
    let to = Buffer::empty(&gpu.client, n);
    launch!(
        &gpu.client,
        gather_words::launch,
        (cubes(n, 256), units()),
        [from, rows, to],
        [n as u32]
    );
    to
}

/// The rows of `from` that `rows` names: `n` of them, the first `n_static` static; zeros for
/// [`NOTHING`]. What is bound is left to [`Bound::gathered`].
pub fn gathered(
    gpu: &Gpu,
    from: &DeviceSplats,
    rows: &Buffer,
    (n, n_static): (usize, usize),
) -> DeviceSplats {
    let columns = parts(from.layout).map(|range| range.len());
    let old = [
        (from.n, 0),
        (from.n, 0),
        (from.n - from.n_static, from.n_static),
    ];
    let new = [(n, 0), (n, 0), (n - n_static, n_static)];
    let buffers = from.buffers();
    let [geometry, colour, time] = [0, 1, 2].map(|k| {
        let ((old, old_first), (new, new_first)) = (old[k], new[k]);
        let to = Buffer::empty(&gpu.client, columns[k] * new);
        if columns[k] * new > 0 {
            launch!(
                &gpu.client,
                gather_columns::launch,
                (cubes(new, 256), units()),
                [buffers[k], rows, to],
                [
                    columns[k] as u32,
                    old as u32,
                    old_first as u32,
                    new as u32,
                    new_first as u32
                ]
            );
        }
        to
    });
    DeviceSplats {
        geometry,
        colour,
        time,
        layout: from.layout,
        n,
        n_static,
        bound: None,
    }
}

/// `columns` columns of `old` rows, the first of which is splat `old_first`, become columns of
/// `new` rows.
#[cube(launch)]
fn gather_columns(
    from: &[f32],
    rows: &[u32],
    to: &mut [f32],
    columns: u32,
    old: u32,
    old_first: u32,
    new: u32,
    new_first: u32,
) {
    let i = ABSOLUTE_POS as u32;
    if i < new {
        let row = rows[(new_first + i) as usize];
        for c in 0u32..columns {
            let mut value = 0.0f32;
            if row != NOTHING {
                value = from[(c * old + row - old_first) as usize];
            }
            to[(c * new + i) as usize] = value;
        }
    }
}

/// As [`gathered`], of one buffer of `columns` columns of words: `old` rows, the first of which is
/// splat `old_first`, become `new` rows from splat `new_first` on.
pub(crate) fn gathered_columns(
    gpu: &Gpu,
    from: &Buffer,
    rows: &Buffer,
    columns: usize,
    (old, old_first): (usize, usize),
    (new, new_first): (usize, usize),
) -> Buffer {
    let to = Buffer::empty(&gpu.client, columns * new);
    launch!(
        &gpu.client,
        gather_word_columns::launch,
        (cubes(new, 256), units()),
        [from, rows, to],
        [
            columns as u32,
            old as u32,
            old_first as u32,
            new as u32,
            new_first as u32
        ]
    );
    to
}

#[cube(launch)]
fn gather_word_columns(
    from: &[u32],
    rows: &[u32],
    to: &mut [u32],
    columns: u32,
    old: u32,
    old_first: u32,
    new: u32,
    new_first: u32,
) {
    let i = ABSOLUTE_POS as u32;
    if i < new {
        let row = rows[(new_first + i) as usize];
        for c in 0u32..columns {
            to[(c * new + i) as usize] = from[(c * old + row - old_first) as usize];
        }
    }
}

#[cube(launch)]
fn gather_words(from: &[u32], rows: &[u32], to: &mut [u32], n: u32) {
    let i = ABSOLUTE_POS;
    if i < n as usize {
        let row = rows[i];
        let mut value = 0u32;
        if row != NOTHING {
            value = from[row as usize];
        }
        to[i] = value;
    }
}
