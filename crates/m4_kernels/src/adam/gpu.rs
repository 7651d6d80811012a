//! Sparse Adam: one unit per splat, for all its columns.
use crate::gpu::found::check_parameter;
use cubecl::prelude::*;

/// One optimiser step on `columns` columns of `rows` rows that start at splat `first`; `counts` are after this step's
/// increment. `tally` notes parameters that are not finite.
#[cube(launch)]
pub(crate) fn adam(
    x: &mut [f32],
    g: &[f32],
    m: &mut [f32],
    v: &mut [f32],
    touched: &[u32],
    counts: &[u32],
    rates: &[f32],
    tally: &mut [u32],
    rows: u32,
    first: u32,
    n_static: u32,
    columns: u32,
    beta1: f32,
    beta2_static: f32,
    beta2_dynamic: f32,
    epsilon: f32,
    #[comptime] sparse: bool,
) {
    let i = ABSOLUTE_POS as u32;
    if i < rows {
        let splat = first + i;
        let seen = touched[splat as usize] != 0u32;
        let mut on = seen;
        if comptime!(!sparse) {
            on = true;
        }
        if on {
            let mut beta2 = beta2_static;
            if splat >= n_static {
                beta2 = beta2_dynamic;
            }
            let steps = f32::cast_from(counts[splat as usize]);
            let bias1 = 1.0f32 / (1.0f32 - (steps * beta1.ln()).exp());
            let bias2 = 1.0f32 / (1.0f32 - (steps * beta2.ln()).exp());
            for c in 0u32..columns {
                let at = (c * rows + i) as usize;
                let mut gradient = 0.0f32;
                if seen {
                    gradient = g[at];
                }
                let mean = beta1 * m[at] + (1.0f32 - beta1) * gradient;
                let square = beta2 * v[at] + (1.0f32 - beta2) * gradient * gradient;
                m[at] = mean;
                v[at] = square;
                let moved = x[at] - rates[c as usize] * mean * bias1 / ((square * bias2).sqrt() + epsilon);
                x[at] = moved;
                check_parameter(moved, tally);
            }
        }
    }
}

/// One more step for every splat that is stepped.
#[cube(launch)]
pub(crate) fn count_steps(touched: &[u32], counts: &mut [u32], n: u32, #[comptime] sparse: bool) {
    let i = ABSOLUTE_POS;
    if i < n as usize {
        let mut on = touched[i] != 0u32;
        if comptime!(!sparse) {
            on = true;
        }
        if on {
            counts[i] += 1u32;
        }
    }
}
