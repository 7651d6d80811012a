//! Sparse Adam: one unit per splat, for all its columns.
use super::cpu::AdamConfig;
use crate::gpu::Gpu;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::splats::{DeviceSplats, parts};
use crate::gpu::tally::{Tally, check_parameter};
use cubecl::prelude::*;

/// The optimiser's state on the device.
#[derive(Debug)]
pub struct DeviceAdam {
    /// First moments.
    pub m: DeviceSplats,
    /// Second moments.
    pub v: DeviceSplats,
    /// Steps of each splat.
    pub steps: Buffer,
}

/// One step of the splats that `touched` names along `gradients`, one rate per column.
pub fn step(
    gpu: &Gpu,
    splats: &DeviceSplats,
    gradients: &DeviceSplats,
    touched: &Buffer,
    state: &DeviceAdam,
    tally: &Tally,
    config: &AdamConfig,
    rates: &[f32],
) {
    let client = &gpu.client;
    let (n, n_static) = (splats.n, splats.n_static);
    count_steps::launch(client, cubes(n, 256), units(), touched.arg(), state.steps.arg(), n as u32, config.sparse);
    let buffers = [splats, gradients, &state.m, &state.v].map(DeviceSplats::buffers);
    for (k, columns) in parts(splats.layout).into_iter().enumerate() {
        let [x, g, m, v] = buffers.map(|buffers| buffers[k]);
        let first = if k == 2 { n_static } else { 0 };
        let rows = n - first;
        if rows == 0 {
            continue;
        }
        let count = columns.len() as u32;
        let rates = Buffer::floats(client, &rates[columns]);
        adam::launch(
            client,
            cubes(rows, 256),
            units(),
            x.arg(),
            g.arg(),
            m.arg(),
            v.arg(),
            touched.arg(),
            state.steps.arg(),
            rates.arg(),
            tally.buffer.arg(),
            rows as u32,
            first as u32,
            n_static as u32,
            count,
            config.beta1 as f32,
            config.beta2 as f32,
            config.beta2_dynamic as f32,
            config.eps as f32,
            config.sparse,
        );
    }
}

/// One optimiser step on `columns` columns of `rows` rows that start at splat `first`; `counts` are after this step's
/// increment. `tally` notes parameters that are not finite.
#[cube(launch)]
fn adam(
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
fn count_steps(touched: &[u32], counts: &mut [u32], n: u32, #[comptime] sparse: bool) {
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
