//! The SIMD twin of the optimiser step.

use super::AdamParams;
use crate::{
    Gradients, SimdLevel,
    simd::{LANES, all, load, store},
};
use fearless_simd::{Simd, dispatch, prelude::*};
use fearless_simd_macros::simd;
use m4_scene::{ShapeError, Splats};
use rayon::prelude::*;

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

/// Rows a task.
const CHUNK_ROWS: usize = 4096;

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
    let most = state.step.iter().copied().max().unwrap_or(0) + 1;
    let first_bias = bias_table(config.beta1, most);
    let bias = [
        bias_table(config.beta2, most),
        bias_table(config.beta2_dynamic, most),
    ];
    let mut counts = state.step.as_mut_slice();
    let mut columns: Vec<Column<'_>> = splats
        .columns_mut()
        .zip(state.m.columns_mut().zip(state.v.columns_mut()))
        .zip(gradients.columns.iter().zip(lr))
        .map(|((x, (m, v)), (g, &lr))| Column { x, m, v, g, lr })
        .collect();
    let mut tasks = Vec::new();
    for (rows, dynamic) in [(0..n_static, false), (n_static..n, true)] {
        for start in rows.clone().step_by(CHUNK_ROWS) {
            let len = CHUNK_ROWS.min(rows.end - start);
            let of_all = layout.shared_columns();
            tasks.push(Task {
                touched: &gradients.touched[start..start + len],
                counts: counts.split_off_mut(..len).unwrap_or_default(),
                columns: columns
                    .iter_mut()
                    .enumerate()
                    .filter(|&(c, _)| c < of_all || dynamic)
                    .map(|(_, column)| column.take(len))
                    .collect(),
                first_bias: &first_bias,
                second_bias: &bias[usize::from(dynamic)],
                beta2: (if dynamic { config.beta2_dynamic } else { config.beta2 }) as f32,
            });
        }
    }
    tasks
        .into_par_iter()
        .for_each(|task| dispatch!(level.level(), s => chunk(s, task, config)));
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

/// Some rows of all columns.
struct Task<'a> {
    touched: &'a [u8],
    counts: &'a mut [u32],
    columns: Vec<Column<'a>>,
    first_bias: &'a [f32],
    second_bias: &'a [f32],
    beta2: f32,
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
fn chunk<S: Simd>(s: S, task: Task<'_>, config: &AdamConfig) {
    let rows = task.counts.len();
    let padded = rows.next_multiple_of(LANES);
    // per row: 1 to step it, 1 if its gradient counts, and the two bias corrections
    let (mut active, mut live) = (vec![0.0f32; padded], vec![0.0f32; padded]);
    let (mut first, mut second) = (vec![1.0f32; padded], vec![1.0f32; padded]);
    for row in 0..rows {
        let touched = task.touched[row] != 0;
        if touched || !config.sparse {
            task.counts[row] += 1;
            let count = task.counts[row] as usize;
            active[row] = 1.0;
            live[row] = f32::from(u8::from(touched));
            first[row] = task.first_bias[count.min(task.first_bias.len() - 1)];
            second[row] = task.second_bias[count.min(task.second_bias.len() - 1)];
        }
    }
    let groups: Vec<usize> = (0..padded)
        .step_by(LANES)
        .filter(|&at| active[at..at + LANES].iter().any(|&a| a != 0.0))
        .collect();
    let (beta1, beta2) = (all(s, config.beta1 as f32), all(s, task.beta2));
    let rest1 = all(s, (1.0 - config.beta1) as f32);
    let rest2 = all(s, 1.0) - beta2;
    let eps = all(s, config.eps as f32);
    let zero = all(s, 0.0);
    for column in task.columns {
        let lr = all(s, column.lr);
        for &at in &groups {
            let on = load(s, &active, at, 0.0).simd_gt(zero);
            let g = load(s, column.g, at, 0.0);
            // untouched rows hold arbitrary gradients, NaN included
            let g = load(s, &live, at, 0.0).simd_gt(zero).select(g, zero);
            let (m0, v0) = (load(s, column.m, at, 0.0), load(s, column.v, at, 0.0));
            let m = beta1.mul_add(m0, rest1 * g);
            let v = beta2.mul_add(v0, rest2 * g * g);
            let root = (v * load(s, &second, at, 1.0)).sqrt() + eps;
            let x0 = load(s, column.x, at, 0.0);
            let x = x0 - lr * (m * load(s, &first, at, 1.0)) / root;
            store(on.select(x, x0), column.x, at);
            store(on.select(m, m0), column.m, at);
            store(on.select(v, v0), column.v, at);
        }
    }
}
