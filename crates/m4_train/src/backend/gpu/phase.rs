//! Harmonics of time of splats whose middles were moved.

use cubecl::prelude::*;
use m4_kernels::gpu::buffer::{Buffer, cubes, units};
use m4_kernels::launch;
use m4_kernels::splats::DeviceSplats;
use std::f32::consts::TAU;

/// Does on the device what [`crate::colour_degree::move_phases`] does: `splats` were the rows
/// `sources` of `parents`.
pub(super) fn move_phases(
    client: &Client,
    parents: &DeviceSplats,
    splats: &DeviceSplats,
    sources: &Buffer,
    period: f32,
) {
    let (layout, n_dynamic) = (splats.layout, splats.n - splats.n_static);
    if layout.time_degree == 0 || n_dynamic == 0 {
        return;
    }
    launch!(
        client,
        move_phase::launch,
        (cubes(n_dynamic, 256), units()),
        [sources, parents.time, splats.time, splats.colour],
        [
            parents.n_static as u32,
            splats.n as u32,
            splats.n_static as u32,
            1.0 / period,
            3 * layout.sh_terms() as u32,
            layout.time_degree as u32 + 1
        ]
    );
}

/// `columns` columns of colours for each of `time_terms` harmonics.
#[cube(launch)]
fn move_phase(
    sources: &[u32],
    before: &[f32],
    after: &[f32],
    colour: &mut [f32],
    old_static: u32,
    n: u32,
    n_static: u32,
    inverse_period: f32,
    #[comptime] columns: u32,
    #[comptime] time_terms: u32,
) {
    let i = ABSOLUTE_POS as u32;
    if i < n - n_static {
        let row = n_static + i;
        let dt = after[i as usize] - before[(sources[row as usize] - old_static) as usize];
        if dt != 0.0f32 {
            for term in 1u32..time_terms {
                let factor = (TAU * f32::cast_from(term) * dt * inverse_period).cos();
                for c in 0u32..columns {
                    colour[((term * columns + c) * n + row) as usize] *= factor;
                }
            }
        }
    }
}
