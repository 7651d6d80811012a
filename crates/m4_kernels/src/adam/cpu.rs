//! The SIMD version of the optimiser step.

use super::{AdamParams, FIXED, nodes::NodeMoments};
use crate::{
    Gradients, SimdLevel,
    simd::{LANES, all, dispatch, each, exp_m1},
};
use fearless_simd::{Simd, f32x16, prelude::*, u32x16};
use fearless_simd_macros::simd;
use m4_core::Splats;
use rayon::prelude::*;

/// The constants of Adam for a whole set of splats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdamConfig {
    /// Decay of the first moment. 0.9 (Kingma and Ba; 3DGS).
    pub beta1: f64,
    /// Decay of the second moment of static splats. 0.999 (Kingma and Ba; 3DGS).
    pub beta2: f64,
    /// Decay of the second moment of dynamic splats. 0.99: they see some 220 steps, and 0.999 looks
    /// back a thousand (docs/spec/optimiser.md 3).
    pub beta2_dynamic: f64,
    /// Added to the root of the second moment. 1e-15 (3DGS).
    pub eps: f64,
    /// Leave splats alone that the frame did not touch. true (docs/spec/optimiser.md 3); false is
    /// the dense Adam of 3DGS, for which an untouched splat has gradient 0.
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
    /// `[n]` steps taken, or [`FIXED`].
    pub step: Vec<u32>,
    /// Of the nodes of each window.
    pub nodes: Vec<NodeMoments>,
}

impl AdamState {
    /// Nothing seen yet.
    pub fn new(splats: &Splats) -> Self {
        let zero = Splats::zeros(splats.layout(), splats.n_static(), splats.n_dynamic());
        let nodes = splats.windows().iter().map(NodeMoments::new).collect();
        Self {
            m: zero.clone(),
            v: zero,
            step: vec![0; splats.n()],
            nodes,
        }
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

/// Rows a task: every column of them is long enough for the processor to stream, and what the
/// columns share stays in the first-level cache.
const CHUNK_ROWS: usize = 8192;

/// One step of every splat that `gradients` touch (of every splat unless `config.sparse`). `lr`
/// holds one learning rate per column, in the order of [`Splats::columns`]. Panics if `lr`,
/// `gradients` or `state` do not fit `splats`.
pub fn step(
    level: SimdLevel,
    splats: &mut Splats,
    gradients: &Gradients,
    state: &mut AdamState,
    config: &AdamConfig,
    lr: &[f32],
) {
    let (n, n_static, layout) = (splats.n(), splats.n_static(), splats.layout());
    assert_eq!(
        lr.len(),
        layout.columns(),
        "adam: one learning rate a column"
    );
    assert_eq!(
        gradients.touched.len(),
        n,
        "adam: gradients of these splats"
    );
    assert_eq!(
        gradients.columns.len(),
        lr.len(),
        "adam: gradients of these splats"
    );
    assert!(
        state.step.len() == n && state.m.n_static() == n_static && state.m.layout() == layout,
        "adam: the state of these splats"
    );
    let mut columns: Vec<Column<'_>> = splats
        .columns_mut()
        .zip(state.m.columns_mut().zip(state.v.columns_mut()))
        .zip(gradients.columns.iter().zip(lr))
        .map(|((x, (m, v)), (g, &lr))| Column { x, m, v, g, lr })
        .collect();
    let (mut touched, mut counts) = (gradients.touched.as_slice(), state.step.as_mut_slice());
    let mut chunks = Vec::new();
    for (rows, dynamic) in [(n_static, false), (n - n_static, true)] {
        let present = if dynamic {
            columns.len()
        } else {
            layout.shared_columns()
        };
        for start in (0..rows).step_by(CHUNK_ROWS) {
            let len = CHUNK_ROWS.min(rows - start);
            let here = touched.split_off(..len).unwrap_or_default();
            let count = counts.split_off_mut(..len).unwrap_or_default();
            let parts = columns[..present].iter_mut().map(|column| column.take(len));
            // of a long video most chunks lie in other frames
            if config.sparse && here.iter().all(|&t| t == 0) {
                parts.for_each(drop);
            } else {
                chunks.push(Chunk {
                    dynamic,
                    touched: here,
                    counts: count,
                    columns: parts.collect(),
                });
            }
        }
    }
    chunks
        .into_par_iter()
        .for_each_init(Bias::default, |bias, chunk| {
            dispatch!(level.level(), s => update(s, chunk, config, bias));
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
        Self {
            x: self.x.split_off_mut(..len).unwrap_or_default(),
            m: self.m.split_off_mut(..len).unwrap_or_default(),
            v: self.v.split_off_mut(..len).unwrap_or_default(),
            g: self.g.split_off(..len).unwrap_or_default(),
            lr: self.lr,
        }
    }
}

/// Some rows of every column that they have.
struct Chunk<'a> {
    dynamic: bool,
    touched: &'a [u8],
    counts: &'a mut [u32],
    columns: Vec<Column<'a>>,
}

/// What the columns of a chunk share, a value per row.
#[derive(Debug, Default)]
struct Bias {
    /// `1 / (1 - beta1^count)`; 0 for splats that are not stepped.
    first: Vec<f32>,
    /// `1 / (1 - beta2^count)`.
    second: Vec<f32>,
    /// Above 0 where the gradient counts.
    live: Vec<f32>,
}

impl Bias {
    /// Counts the step and fills in the corrections of bias.
    #[inline(always)]
    fn fill<S: Simd>(&mut self, s: S, chunk: &mut Chunk<'_>, config: &AdamConfig, beta2: f64) {
        let rows = chunk.touched.len();
        for column in [&mut self.first, &mut self.second, &mut self.live] {
            column.clear();
            column.resize(rows.next_multiple_of(LANES), 0.0);
        }
        let (real, zero) = (all(s, 1.0), all(s, 0.0));
        let (log1, log2) = (all(s, config.beta1.ln() as f32), all(s, beta2.ln() as f32));
        let (one, none) = (u32x16::splat(s, 1), u32x16::splat(s, 0));
        for at in (0..rows).step_by(LANES) {
            let (mut counts, mut marks) = ([0u32; LANES], [0u32; LANES]);
            match (
                chunk.counts.get(at..at + LANES),
                chunk.touched.get(at..at + LANES),
            ) {
                (Some(here), Some(touched)) => {
                    counts.copy_from_slice(here);
                    for k in 0..LANES {
                        marks[k] = u32::from(touched[k]);
                    }
                }
                _ => {
                    for k in 0..rows - at {
                        (counts[k], marks[k]) =
                            (chunk.counts[at + k], u32::from(chunk.touched[at + k]));
                    }
                }
            }
            let counts = u32x16::from_slice(s, &counts);
            let free = counts.simd_lt(u32x16::splat(s, FIXED));
            let live = u32x16::from_slice(s, &marks).simd_gt(none) & free;
            let step = if config.sparse {
                live.select(one, none)
            } else {
                free.select(one, none)
            };
            let counts = counts + step;
            match chunk.counts.get_mut(at..at + LANES) {
                Some(here) => counts.store_slice(here),
                None => chunk.counts[at..].copy_from_slice(&counts.to_array()[..rows - at]),
            }
            let on = step.simd_gt(none);
            let counts = counts.to_float::<f32x16<S>>();
            let first = real / (zero - exp_m1(s, counts * log1));
            let second = real / (zero - exp_m1(s, counts * log2));
            live.select(real, zero)
                .store_slice(&mut self.live[at..at + LANES]);
            on.select(first, zero)
                .store_slice(&mut self.first[at..at + LANES]);
            on.select(second, real)
                .store_slice(&mut self.second[at..at + LANES]);
        }
    }
}

#[simd]
fn update<S: Simd>(s: S, mut chunk: Chunk<'_>, config: &AdamConfig, bias: &mut Bias) {
    let beta2 = if chunk.dynamic {
        config.beta2_dynamic
    } else {
        config.beta2
    };
    bias.fill(s, &mut chunk, config, beta2);
    for column in chunk.columns {
        let rule = Rule::new(s, config, beta2, column.lr);
        let whole = column.x.len() / LANES * LANES;
        let (x, x_end) = column.x.split_at_mut(whole);
        let (m, m_end) = column.m.split_at_mut(whole);
        let (v, v_end) = column.v.split_at_mut(whole);
        let (g, g_end) = column.g.split_at(whole);
        let rows = x.chunks_exact_mut(LANES).zip(m.chunks_exact_mut(LANES));
        let rows = rows
            .zip(v.chunks_exact_mut(LANES))
            .zip(g.chunks_exact(LANES));
        let shared = bias
            .first
            .chunks_exact(LANES)
            .zip(bias.second.chunks_exact(LANES));
        let shared = shared.zip(bias.live.chunks_exact(LANES));
        for ((((x, m), v), g), ((first, second), live)) in rows.zip(shared) {
            rule.apply(s, x, m, v, g, [first, second, live]);
        }
        if !x_end.is_empty() {
            let parts: [&[f32]; 4] = [&*x_end, &*m_end, &*v_end, g_end];
            let mut padded = [[0.0f32; LANES]; 4];
            for (padded, part) in padded.iter_mut().zip(parts) {
                padded[..part.len()].copy_from_slice(part);
            }
            let [x, m, v, g] = &mut padded;
            let shared = [
                &bias.first[whole..],
                &bias.second[whole..],
                &bias.live[whole..],
            ];
            rule.apply(s, x, m, v, g, shared);
            for (padded, part) in padded.iter().zip([x_end, m_end, v_end]) {
                part.copy_from_slice(&padded[..part.len()]);
            }
        }
    }
}

/// The constants of one column.
#[derive(Debug, Clone, Copy)]
struct Rule<S: Simd> {
    beta: [f32x16<S>; 2],
    /// One minus those.
    rest: [f32x16<S>; 2],
    eps: f32x16<S>,
    lr: f32x16<S>,
}

impl<S: Simd> Rule<S> {
    #[inline(always)]
    fn new(s: S, config: &AdamConfig, beta2: f64, lr: f32) -> Self {
        let beta2 = all(s, beta2 as f32);
        Self {
            beta: [all(s, config.beta1 as f32), beta2],
            rest: [all(s, (1.0 - config.beta1) as f32), all(s, 1.0) - beta2],
            eps: all(s, config.eps as f32),
            lr: all(s, lr),
        }
    }

    /// Sixteen rows; `shared` holds those of [`Bias`].
    #[inline(always)]
    fn apply(
        &self,
        s: S,
        x: &mut [f32],
        m: &mut [f32],
        v: &mut [f32],
        g: &[f32],
        shared: [&[f32]; 3],
    ) {
        let zero = all(s, 0.0);
        let [first, second, live] = shared;
        let first = f32x16::from_slice(s, first);
        let on = first.simd_gt(zero);
        if !on.any_true() {
            return;
        }
        // untouched rows hold arbitrary gradients, NaN included
        let live = f32x16::from_slice(s, live).simd_gt(zero);
        let second = f32x16::from_slice(s, second);
        let gradient = f32x16::from_slice(s, g);
        let old = [
            f32x16::from_slice(s, x),
            f32x16::from_slice(s, m),
            f32x16::from_slice(s, v),
        ];
        // neighbours are mostly seen together; loads and stores under a mask cost
        let new = if live.all_true() {
            self.next(&old, gradient, first, second)
        } else {
            let new = self.next(&old, live.select(gradient, zero), first, second);
            each!(3, k => on.select(new[k], old[k]))
        };
        new[0].store_slice(x);
        new[1].store_slice(m);
        new[2].store_slice(v);
    }

    /// Parameter and moments after the step.
    #[inline(always)]
    fn next(
        &self,
        [x, m, v]: &[f32x16<S>; 3],
        g: f32x16<S>,
        first: f32x16<S>,
        second: f32x16<S>,
    ) -> [f32x16<S>; 3] {
        let m = self.beta[0].mul_add(*m, self.rest[0] * g);
        let v = self.beta[1].mul_add(*v, self.rest[1] * g * g);
        let root = (v * second).sqrt() + self.eps;
        [*x - self.lr * (m * first) / root, m, v]
    }
}
