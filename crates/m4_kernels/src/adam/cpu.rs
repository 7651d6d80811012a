//! The SIMD twin of the optimiser step.

use super::AdamParams;
use crate::{Gradients, SimdLevel};
use m4_scene::{ShapeError, Splats};

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
    let _ = level;
    assert_eq!(lr.len(), splats.layout().columns(), "adam: one learning rate a column");
    let (n_static, shared) = (splats.n_static(), splats.layout().shared_columns());
    let active: Vec<bool> = gradients.touched.iter().map(|&t| t != 0 || !config.sparse).collect();
    for (count, _) in state.step.iter_mut().zip(&active).filter(|(_, a)| **a) {
        *count += 1;
    }
    let moments = state.m.columns_mut().zip(state.v.columns_mut());
    for (c, (x, (m, v))) in splats.columns_mut().zip(moments).enumerate() {
        let first = if c < shared { 0 } else { n_static };
        for k in 0..x.len() {
            let row = first + k;
            if !active[row] {
                continue;
            }
            let beta2 = if row < n_static {
                config.beta2
            } else {
                config.beta2_dynamic
            };
            let params = AdamParams {
                beta1: config.beta1,
                beta2,
                epsilon: config.eps,
            };
            let g = if gradients.touched[row] == 0 {
                0.0
            } else {
                gradients.columns[c][k]
            };
            (x[k], m[k], v[k]) = super::reference::update(x[k], g, m[k], v[k], state.step[row], lr[c], &params);
        }
    }
}
