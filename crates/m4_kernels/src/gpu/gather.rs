//! Gathers rows of splats into a new order on the device.

use crate::gpu::Gpu;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::splats::{DeviceSplats, parts};
use cubecl::prelude::*;

/// In place of a row for splats that start from nothing.
pub const NOTHING: u32 = u32::MAX;

/// The numbers of `from` that `rows` names, one per splat: `n` of them, 0 for [`NOTHING`].
#[must_use]
pub fn gathered_words(gpu: &Gpu, from: &Buffer, rows: &Buffer, n: usize) -> Buffer {
    let to = Buffer::empty(&gpu.client, n);
    gather_words::launch(&gpu.client, cubes(n, 256), units(), from.arg(), rows.arg(), to.arg(), n as u32);
    to
}

/// The rows of `from` that `rows` names: `n` of them, the first `n_static` static; zeros for [`NOTHING`].
#[must_use]
pub fn gathered(gpu: &Gpu, from: &DeviceSplats, rows: &Buffer, (n, n_static): (usize, usize)) -> DeviceSplats {
    let columns = parts(from.layout).map(|range| range.len());
    let old = [(from.n, 0), (from.n, 0), (from.n - from.n_static, from.n_static)];
    let new = [(n, 0), (n, 0), (n - n_static, n_static)];
    let buffers = from.buffers();
    let [geometry, colour, time] = [0, 1, 2].map(|k| {
        let ((old, old_first), (new, new_first)) = (old[k], new[k]);
        let to = Buffer::empty(&gpu.client, columns[k] * new);
        if columns[k] * new > 0 {
            gather_columns::launch(
                &gpu.client,
                cubes(new, 256),
                units(),
                buffers[k].arg(),
                rows.arg(),
                to.arg(),
                columns[k] as u32,
                old as u32,
                old_first as u32,
                new as u32,
                new_first as u32,
            );
        }
        to
    });
    DeviceSplats { geometry, colour, time, layout: from.layout, n, n_static }
}

/// `columns` columns of `old` rows, the first of which is splat `old_first`, become columns of `new` rows.
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
