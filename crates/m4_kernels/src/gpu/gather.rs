//! Gathers rows of splats into a new order on the device.

use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::splats::{DeviceSplats, parts};
use crate::gpu::work::Size;
use crate::gpu::{Gpu, GpuError, Trainer};
use cubecl::prelude::*;
use m4_core::{ShapeError, Splats};

/// In place of a row for splats that start from nothing.
pub(crate) const NOTHING: u32 = u32::MAX;

/// What becomes of the splats: where each comes from, and those that are not what they were.
#[derive(Debug, Clone, Copy)]
pub struct DensifyPlan<'a> {
    /// Row `i` of the next splats is row `rows[i]` of those there are; static rows come from static ones, dynamic from
    /// dynamic.
    pub rows: &'a [u32],
    /// Of the next splats, how many are static.
    pub n_static: usize,
    /// Where the optimiser's state starts from nothing, one flag per row.
    pub is_new: &'a [bool],
    /// Rows that are other than the row they come from, static ones first.
    pub changed: &'a [u32],
    /// What they are: as many splats as `changed`, in that order.
    pub values: &'a Splats,
}

impl Trainer {
    /// Goes on with other splats: the rows that stay what they are never leave the device.
    ///
    /// # Errors
    ///
    /// [`GpuError::Shape`] if rows, flags and values are not as many, the values have other columns, or a row is not
    /// there: nothing is changed then. [`GpuError`] if it does not fit; the trainer is not to be used after that.
    pub fn regrow(&mut self, next: &DensifyPlan<'_>) -> Result<(), GpuError> {
        let (n, n_static, values) = (next.rows.len(), next.n_static, next.values);
        self.check(next)?;
        let client = self.gpu.client.clone();
        let sources = Buffer::words(&client, next.rows);
        let state = next.rows.iter().zip(next.is_new);
        let state: Vec<u32> = state.map(|(&row, &new)| if new { NOTHING } else { row }).collect();
        gather_state(self, &Buffer::words(&client, &state), (n, n_static));
        let splats = gathered(&self.gpu, &self.splats, &sources, (n, n_static));
        if !next.changed.is_empty() {
            let changed = Buffer::words(&client, next.changed);
            let from = DeviceSplats::upload(&self.gpu, values)?;
            let count = (values.n(), values.n_static());
            for (k, part) in parts(splats.layout).into_iter().enumerate() {
                let [to, from] = [&splats, &from].map(|s| [&s.geometry, &s.colour, &s.time][k]);
                let (first, new_first) = if k == 2 { (count.1, n_static) } else { (0, 0) };
                if part.is_empty() || count.0 == first {
                    continue;
                }
                scatter_columns::launch(
                    &client,
                    cubes(count.0 - first, 256),
                    units(),
                    from.arg(),
                    changed.arg(),
                    to.arg(),
                    part.len() as u32,
                    (count.0 - first) as u32,
                    first as u32,
                    (n - new_first) as u32,
                    new_first as u32,
                );
            }
        }
        self.splats = splats;
        self.gradients = self.splats.like(&self.gpu);
        self.make(Size { n, ..self.work.size })
    }

    fn check(&self, next: &DensifyPlan<'_>) -> Result<(), GpuError> {
        let (n, n_static) = (next.rows.len(), next.n_static);
        ShapeError::check("regrow: is_new", n, next.is_new.len())?;
        ShapeError::check("regrow: values", next.changed.len(), next.values.n())?;
        ShapeError::check(
            "regrow: columns",
            self.splats.layout.columns(),
            next.values.layout().columns(),
        )?;
        let wrong = |what, expected: usize, found: u32| {
            Err(GpuError::Shape(ShapeError {
                what,
                expected,
                found: found as usize,
            }))
        };
        let (old, old_static) = (self.splats.n as u32, self.splats.n_static as u32);
        for (i, &row) in next.rows.iter().enumerate() {
            let there = if i < n_static { 0..old_static } else { old_static..old };
            if !there.contains(&row) {
                return wrong("regrow: row", there.end as usize, row);
            }
        }
        for (i, &row) in next.changed.iter().enumerate() {
            let there = if i < next.values.n_static() {
                0..n_static
            } else {
                n_static..n
            };
            if !there.contains(&(row as usize)) {
                return wrong("regrow: changed row", there.end, row);
            }
        }
        Ok(())
    }
}

/// The optimiser's state of rows that were gathered; nothing where there is no row.
pub(crate) fn gather_state(trainer: &mut Trainer, rows: &Buffer, shape: (usize, usize)) {
    trainer.m = gathered(&trainer.gpu, &trainer.m, rows, shape);
    trainer.v = gathered(&trainer.gpu, &trainer.v, rows, shape);
    let steps = Buffer::empty(&trainer.gpu.client, shape.0);
    gather_counts::launch(
        &trainer.gpu.client,
        cubes(shape.0, 256),
        units(),
        trainer.steps.arg(),
        rows.arg(),
        steps.arg(),
        shape.0 as u32,
    );
    trainer.steps = steps;
}

/// The rows of `from` that `rows` names: `n` of them, the first `n_static` static.
pub(crate) fn gathered(gpu: &Gpu, from: &DeviceSplats, rows: &Buffer, (n, n_static): (usize, usize)) -> DeviceSplats {
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

/// Rows of `columns` columns, `count` of them, take their places among `new` rows: row `i` is splat `changed[first + i]`.
#[cube(launch)]
fn scatter_columns(
    from: &[f32],
    changed: &[u32],
    to: &mut [f32],
    columns: u32,
    count: u32,
    first: u32,
    new: u32,
    new_first: u32,
) {
    let i = ABSOLUTE_POS as u32;
    if i < count {
        let row = changed[(first + i) as usize] - new_first;
        for c in 0u32..columns {
            to[(c * new + row) as usize] = from[(c * count + i) as usize];
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
