//! The optimiser's state of splats that were rearranged, without it leaving the device.

use crate::buffer::{Buffer, cubes, units};
use crate::splats::{DeviceSplats, parts};
use crate::{Gpu, GpuError, Trainer};
use cubecl::prelude::*;
use m4_scene::{ShapeError, Splats};

/// In place of a row for splats that start from nothing.
const NOTHING: u32 = u32::MAX;

impl Trainer {
    /// Goes on with `splats`. Row `i` of the optimiser's state is row `rows[i]` of the one there is, or nothing where
    /// `newborn[i]`; static rows come from static ones, dynamic from dynamic.
    ///
    /// # Errors
    ///
    /// [`GpuError::Shape`] if rows, flags and splats are not as many, the splats have other columns, or a row is not
    /// there: nothing is changed then. [`GpuError`] if it does not fit; the trainer is not to be used after that.
    pub fn rearrange(&mut self, splats: &Splats, rows: &[u32], newborn: &[bool]) -> Result<(), GpuError> {
        let (n, n_static) = (splats.n(), splats.n_static());
        ShapeError::check("rearrange: rows", n, rows.len())?;
        ShapeError::check("rearrange: newborn", n, newborn.len())?;
        ShapeError::check(
            "rearrange: columns",
            self.splats.layout.columns(),
            splats.layout().columns(),
        )?;
        let (old, old_static) = (self.splats.n as u32, self.splats.n_static as u32);
        for (i, &row) in rows.iter().enumerate() {
            let there = if i < n_static { 0..old_static } else { old_static..old };
            if !there.contains(&row) {
                return Err(GpuError::Shape(ShapeError {
                    what: "rearrange: row",
                    expected: there.end as usize,
                    found: row as usize,
                }));
            }
        }
        let rows: Vec<u32> = rows
            .iter()
            .zip(newborn)
            .map(|(&row, &new)| if new { NOTHING } else { row })
            .collect();
        let rows = Buffer::words(&self.gpu.client, &rows);
        let shape = (n, n_static);
        self.m = gathered(&self.gpu, &self.m, &rows, shape);
        self.v = gathered(&self.gpu, &self.v, &rows, shape);
        let steps = Buffer::empty(&self.gpu.client, n);
        gather_counts::launch(
            &self.gpu.client,
            cubes(n, 256),
            units(),
            self.steps.arg(),
            rows.arg(),
            steps.arg(),
            n as u32,
        );
        self.steps = steps;
        self.replace_splats(splats)
    }
}

/// The rows of `from` that `rows` names: `n` of them, the first `n_static` static.
fn gathered(gpu: &Gpu, from: &DeviceSplats, rows: &Buffer, (n, n_static): (usize, usize)) -> DeviceSplats {
    let columns = parts(from.layout).map(|range| range.len());
    let old = [(from.n, 0), (from.n, 0), (from.n - from.n_static, from.n_static)];
    let new = [(n, 0), (n, 0), (n - n_static, n_static)];
    let buffers = [&from.geometry, &from.colour, &from.time];
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
    DeviceSplats {
        geometry,
        colour,
        time,
        layout: from.layout,
        n,
        n_static,
    }
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
fn gather_counts(from: &[u32], rows: &[u32], to: &mut [u32], n: u32) {
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
