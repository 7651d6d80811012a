//! The SIMD twin of the optimiser step.

use super::AdamParams;
use crate::{
    Gradients, SimdLevel,
    simd::{LANES, all, dispatch, load, store},
};
use fearless_simd::{Simd, prelude::*};
use fearless_simd_macros::simd;
use m4_scene::{ShapeError, Splats};
use rayon::prelude::*;
use std::ops::Range;

/// The constants of Adam for a whole set of splats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdamConfig {
    /// Decay of the first moment. 0.9 (Kingma and Ba; 3DGS).
    pub beta1: f64,
    /// Decay of the second moment of static splats. 0.999 (Kingma and Ba; 3DGS).
    pub beta2: f64,
    /// Decay of the second moment of dynamic splats. 0.99: they see some 220 steps, and 0.999 looks
    /// back a thousand (section 3).
    pub beta2_dynamic: f64,
    /// Added to the root of the second moment. 1e-15 (3DGS).
    pub eps: f64,
    /// Leave splats alone that the frame did not touch. true (section 3); false is the dense Adam of
    /// 3DGS, for which an untouched splat has gradient 0.
    pub sparse: bool,
}

impl Default for AdamConfig {
    fn default() -> Self {
        let params = AdamParams::default();
        Self {
            beta1: params.beta1,
            beta2: params.beta2,
            beta2_dynamic: 0.99,
            eps: params.epsilon,
            sparse: true,
        }
    }
}

/// The moments of every parameter and how often each splat was stepped.
#[derive(Debug, Clone, PartialEq)]
pub struct AdamState {
    /// First moments, same columns as the splats.
    pub m: Splats,
    /// Second moments, same columns as the splats.
    pub v: Splats,
    /// `[n]` steps taken.
    pub step: Vec<u32>,
}

impl AdamState {
    /// Nothing seen yet.
    #[must_use]
    pub fn new(splats: &Splats) -> Self {
        let zero = Splats::zeros(splats.layout(), splats.n_static(), splats.n_dynamic());
        Self {
            m: zero.clone(),
            v: zero,
            step: vec![0; splats.n()],
        }
    }

    /// The state of `splats.gather(rows)`. Rows for which `newborn` is set start from nothing; the
    /// others keep moments and count. `newborn` may be empty: then nobody is new.
    ///
    /// # Errors
    ///
    /// [`ShapeError`] as [`Splats::gather`], or if `newborn` is neither empty nor as long as `rows`.
    pub fn gather(&self, rows: &[u32], newborn: &[bool]) -> Result<Self, ShapeError> {
        if !newborn.is_empty() {
            ShapeError::check("newborn", rows.len(), newborn.len())?;
        }
        let mut out = Self {
            m: self.m.gather(rows)?,
            v: self.v.gather(rows)?,
            step: rows.iter().map(|&r| self.step[r as usize]).collect(),
        };
        for (row, _) in newborn.iter().enumerate().filter(|&(_, &new)| new) {
            out.forget(row);
        }
        Ok(out)
    }

    /// Sets the moments and the count of one splat back to nothing.
    pub fn forget(&mut self, row: usize) {
        self.step[row] = 0;
        let (shared, n_static) = (self.m.layout().shared_columns(), self.m.n_static());
        for columns in [&mut self.m, &mut self.v] {
            for (c, column) in columns.columns_mut().enumerate() {
                if c < shared {
                    column[row] = 0.0;
                } else if row >= n_static {
                    column[row - n_static] = 0.0;
                }
            }
        }
    }
}

/// Rows a task: long enough for the processor to stream, few enough that what all columns share stays
/// in the second-level cache.
const CHUNK_ROWS: usize = 16_384;

/// One step of every splat that `gradients` touch (of every splat unless `config.sparse`).
/// `lr` holds one learning rate a column, in the order of [`Splats::columns`].
///
/// # Panics
///
/// If `lr`, `gradients` or `state` do not fit `splats`.
pub fn step(
    level: SimdLevel,
    splats: &mut Splats,
    gradients: &Gradients,
    state: &mut AdamState,
    config: &AdamConfig,
    lr: &[f32],
) {
    let (n, n_static, layout) = (splats.n(), splats.n_static(), splats.layout());
    assert_eq!(lr.len(), layout.columns(), "adam: one learning rate a column");
    assert_eq!(gradients.touched.len(), n, "adam: gradients of these splats");
    assert_eq!(gradients.columns.len(), lr.len(), "adam: gradients of these splats");
    assert!(
        state.step.len() == n && state.m.n_static() == n_static && state.m.layout() == layout,
        "adam: the state of these splats"
    );
    let rows = rows(gradients, &mut state.step, config, n_static);
    let mut columns: Vec<Column<'_>> = splats
        .columns_mut()
        .zip(state.m.columns_mut().zip(state.v.columns_mut()))
        .zip(gradients.columns.iter().zip(lr))
        .map(|((x, (m, v)), (g, &lr))| Column { x, m, v, g, lr })
        .collect();
    // chunk by chunk, all columns of one after the other: neighbours share the chunk's rows
    let mut tasks = Vec::new();
    let mut cut = |from: usize, to: usize, dynamic: bool| {
        for start in (from..to).step_by(CHUNK_ROWS) {
            let end = to.min(start + CHUNK_ROWS);
            let first = if dynamic { 0 } else { layout.shared_columns() };
            let here = columns.iter_mut().enumerate();
            let here = here.filter(|&(c, _)| dynamic || c < first);
            tasks.extend(here.map(|(_, column)| (start..end, dynamic, column.take(end - start))));
        }
    };
    cut(0, n_static, false);
    cut(n_static, n, true);
    tasks.into_par_iter().for_each(|(range, dynamic, column)| {
        let rows = rows.range(range);
        let beta2 = if dynamic { config.beta2_dynamic } else { config.beta2 };
        dispatch!(level.level(), s => update(s, column, &rows, config, beta2 as f32));
    });
}

/// A parameter with its moments, gradient and learning rate.
struct Column<'a> {
    x: &'a mut [f32],
    m: &'a mut [f32],
    v: &'a mut [f32],
    g: &'a [f32],
    lr: f32,
}

impl<'a> Column<'a> {
    /// Cuts the first `len` rows off.
    fn take(&mut self, len: usize) -> Self {
        let (g, rest) = self.g.split_at(len);
        self.g = rest;
        Self {
            x: self.x.split_off_mut(..len).unwrap_or_default(),
            m: self.m.split_off_mut(..len).unwrap_or_default(),
            v: self.v.split_off_mut(..len).unwrap_or_default(),
            g,
            lr: self.lr,
        }
    }
}

/// What all columns share, `[n]` each.
#[derive(Debug, Default)]
struct Rows<T> {
    /// `1 / (1 - beta1^count)`; 0 for splats that are not stepped.
    first: T,
    /// `1 / (1 - beta2^count)`.
    second: T,
    /// 1 where the gradient counts, else 0; empty when that is where `first` is above 0.
    live: T,
}

impl Rows<Vec<f32>> {
    fn range(&self, range: Range<usize>) -> Rows<&[f32]> {
        Rows {
            first: &self.first[range.clone()],
            second: &self.second[range.clone()],
            live: self.live.get(range).unwrap_or_default(),
        }
    }
}

/// Counts the step and looks up the corrections of bias.
fn rows(gradients: &Gradients, counts: &mut [u32], config: &AdamConfig, n_static: usize) -> Rows<Vec<f32>> {
    let most = counts.iter().copied().max().unwrap_or(0) + 1;
    let first = bias_table(config.beta1, most);
    let second = [config.beta2, config.beta2_dynamic].map(|beta| bias_table(beta, most));
    let n = counts.len();
    let mut out = Rows {
        first: vec![0.0; n],
        second: vec![1.0; n],
        live: Vec::new(),
    };
    for row in 0..n {
        if gradients.touched[row] != 0 || !config.sparse {
            counts[row] += 1;
            let count = counts[row] as usize;
            let second = &second[usize::from(row >= n_static)];
            out.first[row] = first[count.min(first.len() - 1)];
            out.second[row] = second[count.min(second.len() - 1)];
        }
    }
    if !config.sparse {
        out.live = gradients.touched.iter().map(|&t| f32::from(u8::from(t != 0))).collect();
    }
    out
}

/// `1 / (1 - beta^count)` for counts from 0 (unused) to where it is 1 in f32, or to `most`.
fn bias_table(beta: f64, most: u32) -> Vec<f32> {
    let mut power = 1.0;
    let mut table = vec![1.0f32];
    while table.len() <= most as usize && power > 1e-9 {
        power *= beta;
        table.push((1.0 / (1.0 - power)) as f32);
    }
    table
}

#[simd]
fn update<S: Simd>(s: S, column: Column<'_>, rows: &Rows<&[f32]>, config: &AdamConfig, beta2: f32) {
    let (beta1, beta2) = (all(s, config.beta1 as f32), all(s, beta2));
    let rest1 = all(s, (1.0 - config.beta1) as f32);
    let rest2 = all(s, 1.0) - beta2;
    let eps = all(s, config.eps as f32);
    let (zero, lr) = (all(s, 0.0), all(s, column.lr));
    for at in (0..column.x.len()).step_by(LANES) {
        let first = load(s, rows.first, at, 0.0);
        let on = first.simd_gt(zero);
        if !on.any_true() {
            continue;
        }
        let live = if rows.live.is_empty() {
            first
        } else {
            load(s, rows.live, at, 0.0)
        };
        // untouched rows hold arbitrary gradients, NaN included
        let g = live.simd_gt(zero).select(load(s, column.g, at, 0.0), zero);
        let (m0, v0) = (load(s, column.m, at, 0.0), load(s, column.v, at, 0.0));
        let m = beta1.mul_add(m0, rest1 * g);
        let v = beta2.mul_add(v0, rest2 * g * g);
        let root = (v * load(s, rows.second, at, 1.0)).sqrt() + eps;
        let x0 = load(s, column.x, at, 0.0);
        let x = x0 - lr * (m * first) / root;
        store(on.select(x, x0), column.x, at);
        store(on.select(m, m0), column.m, at);
        store(on.select(v, v0), column.v, at);
    }
}
