//! Sparse Adam: one unit per splat, for all its columns.
use super::{FIXED, cpu::AdamConfig};
use crate::gpu::Gpu;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::tally::{Tally, check_parameter, count_step};
use crate::launch;
use crate::splats::{DeviceSplats, parts};
use cubecl::prelude::*;
use m4_core::Column;
pub use nodes::DeviceNodes;

mod nodes;

/// The optimiser's state on the device.
#[derive(Debug)]
pub struct DeviceAdam {
    /// First moments.
    pub m: DeviceSplats,
    /// Second moments.
    pub v: DeviceSplats,
    /// Steps of each splat, or [`FIXED`].
    pub steps: Buffer,
    /// Of the nodes that carry splats.
    pub nodes: DeviceNodes,
}

/// One step of the splats that `touched` names along `gradients`, one rate per column; `tally`
/// counts it.
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
    let [geometry, colour, time] = parts(splats.layout).map(|columns| columns.len() as u32);
    let trend = splats.layout.range(Column::Trend).len() as u32;
    let rates = gpu.passing(rates);
    launch!(
        client,
        adam::launch,
        (cubes(splats.n, 256), units()),
        [
            splats.geometry,
            splats.colour,
            splats.time,
            gradients.geometry,
            gradients.colour,
            gradients.time,
            state.m.geometry,
            state.m.colour,
            state.m.time,
            state.v.geometry,
            state.v.colour,
            state.v.time,
            touched,
            state.steps,
            rates,
            tally.buffer
        ],
        [
            splats.n as u32,
            splats.n_static as u32,
            splats.n_still() as u32,
            geometry,
            colour,
            time - trend,
            trend,
            config.beta1 as f32,
            config.beta2 as f32,
            config.beta2_dynamic as f32,
            config.eps as f32,
            config.sparse
        ]
    );
}

/// A step of one splat: what its columns have in common.
#[derive(CubeType, Clone, Copy)]
struct Step {
    /// Whether it has a gradient; else that is 0.
    has_gradient: bool,
    beta1: f32,
    beta2: f32,
    /// Corrections of the moments' bias.
    bias1: f32,
    bias2: f32,
    epsilon: f32,
}

/// One step of each splat that is not [`FIXED`], and of its count of steps. `tally` counts the step
/// and the splats touched, and notes parameters that are not finite.
#[cube(launch)]
fn adam(
    geometry: &mut [f32],
    colour: &mut [f32],
    time: &mut [f32],
    d_geometry: &[f32],
    d_colour: &[f32],
    d_time: &[f32],
    m_geometry: &mut [f32],
    m_colour: &mut [f32],
    m_time: &mut [f32],
    v_geometry: &mut [f32],
    v_colour: &mut [f32],
    v_time: &mut [f32],
    touched: &[u32],
    counts: &mut [u32],
    rates: &[f32],
    tally: &[Atomic<u32>],
    n: u32,
    n_static: u32,
    n_still: u32,
    geometry_columns: u32,
    colour_columns: u32,
    time_columns: u32,
    trend_columns: u32,
    beta1: f32,
    beta2_static: f32,
    beta2_dynamic: f32,
    epsilon: f32,
    #[comptime] sparse: bool,
) {
    let i = ABSOLUTE_POS as u32;
    let mut touch_flag = 0u32;
    if i < n {
        touch_flag = touched[i as usize];
    }
    count_step(touch_flag, tally);
    let mut on = touch_flag != 0u32;
    if comptime!(!sparse) {
        on = i < n;
    }
    if on {
        on = counts[i as usize] != FIXED;
    }
    if on {
        let mut beta2 = beta2_static;
        if i >= n_static {
            beta2 = beta2_dynamic;
        }
        let count = counts[i as usize] + 1u32;
        counts[i as usize] = count;
        let steps = f32::cast_from(count);
        let step = Step {
            has_gradient: touch_flag != 0u32,
            beta1,
            beta2,
            bias1: 1.0f32 / (1.0f32 - (steps * beta1.ln()).exp()),
            bias2: 1.0f32 / (1.0f32 - (steps * beta2.ln()).exp()),
            epsilon,
        };
        let mut first = 0u32;
        move_columns(
            geometry,
            d_geometry,
            m_geometry,
            v_geometry,
            rates,
            tally,
            first,
            geometry_columns,
            i,
            n,
            &step,
        );
        first += geometry_columns;
        move_columns(
            colour,
            d_colour,
            m_colour,
            v_colour,
            rates,
            tally,
            first,
            colour_columns,
            i,
            n,
            &step,
        );
        first += colour_columns;
        if i >= n_static {
            let (row, rows) = (i - n_static, n - n_static);
            // free splats have no trend: it is the last of the columns
            let mut columns = time_columns;
            if i < n_still {
                columns += trend_columns;
            }
            move_columns(
                time, d_time, m_time, v_time, rates, tally, first, columns, row, rows, &step,
            );
        }
    }
}

/// A step of row `row` in columns whose rates start at `first`.
#[cube]
fn move_columns(
    x: &mut [f32],
    g: &[f32],
    m: &mut [f32],
    v: &mut [f32],
    rates: &[f32],
    tally: &[Atomic<u32>],
    first: u32,
    columns: u32,
    row: u32,
    rows: u32,
    step: &Step,
) {
    for c in 0u32..columns {
        let at = (c * rows + row) as usize;
        let mut gradient = 0.0f32;
        if step.has_gradient {
            gradient = g[at];
        }
        let mean = step.beta1 * m[at] + (1.0f32 - step.beta1) * gradient;
        let square = step.beta2 * v[at] + (1.0f32 - step.beta2) * gradient * gradient;
        m[at] = mean;
        v[at] = square;
        let rate = rates[(first + c) as usize];
        let moved =
            x[at] - rate * mean * step.bias1 / ((square * step.bias2).sqrt() + step.epsilon);
        x[at] = moved;
        check_parameter(moved, tally);
    }
}
