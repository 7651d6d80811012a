//! Bound splats on the device: the version in CubeCL.
//!
//! | file | what it does |
//! |---|---|
//! | `moment` | what kernels are told of the windows at an instant |
//! | `forward` | poses of nodes between keys, and the splats that they carry |
//! | `backward` | gradients of splats and nodes |
//!
//! What is drawn of a bound splat lies in columns of its own; the stages that follow take it from
//! there and treat the splat as a static one.

use crate::gpu::Gpu;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::launch;
use crate::splats::{Bound, DeviceSplats};
use cubecl::prelude::CubeDim;
pub(crate) use moment::Moment;

mod backward;
mod forward;
mod moment;

const LEAST: f32 = super::LEAST_PRESENCE;

/// Carries the bound splats of `splats`, which `bound` has, to `t`, frames, the instant of `eye`.
/// Gradients of nodes at `existing_keys` will be added to.
pub(crate) fn pose(
    bound: &Bound,
    gpu: &Gpu,
    splats: &DeviceSplats,
    eye: &Buffer,
    t: f32,
    existing_keys: &[(usize, usize)],
) -> Moment {
    let moment = Moment::new(gpu, &bound.windows, &bound.starts, t, existing_keys);
    let client = &gpu.client;
    let units_of_nodes = moment.active * moment.most;
    if units_of_nodes > 0 {
        launch!(
            client,
            forward::move_nodes::launch,
            (cubes(units_of_nodes, 256), units()),
            [bound.poses, bound.anchors, moment.table, bound.motions],
            [list(bound), moment.active as u32, moment.most as u32]
        );
    }
    if bound.n > 0 {
        launch!(
            client,
            forward::pose::launch,
            (cubes(bound.n, 256), units()),
            [
                splats.geometry,
                splats.colour,
                splats.time,
                eye,
                moment.table,
                bound.bindings,
                bound.motions,
                bound.posed
            ],
            [
                splats.n as u32,
                splats.n_static as u32,
                bound.n as u32,
                splats.layout.isotropic
            ]
        );
    }
    moment
}

/// Where the list of windows starts in a table.
fn list(bound: &Bound) -> u32 {
    (bound.windows.len() * moment::WINDOW) as u32
}

/// Turns the gradients with respect to what was drawn of bound splats, in `out`, into those with
/// respect to `splats`, and to the nodes at the keys of `moment`.
pub(crate) fn backward(
    bound: &Bound,
    gpu: &Gpu,
    splats: &DeviceSplats,
    out: &DeviceSplats,
    touched: &Buffer,
    eye: &Buffer,
    moment: &Moment,
) {
    if bound.n == 0 {
        return;
    }
    let client = &gpu.client;
    if !moment.keys.is_empty() {
        launch!(
            client,
            backward::node_sums::launch,
            (
                cubes(moment.active * moment.most, 1),
                CubeDim::new_1d(backward::UNITS as u32)
            ),
            [
                splats.geometry,
                splats.time,
                out.geometry,
                touched,
                eye,
                moment.table,
                bound.bindings,
                bound.motions,
                bound.anchors,
                bound.lists[0],
                bound.lists[1],
                bound.gradients
            ],
            [
                splats.n as u32,
                splats.n_static as u32,
                bound.n as u32,
                list(bound),
                moment.active as u32,
                moment.most as u32,
                splats.layout.isotropic
            ]
        );
    }
    launch!(
        client,
        backward::own_gradients::launch,
        (cubes(bound.n, 256), units()),
        [
            splats.geometry,
            splats.time,
            out.geometry,
            out.colour,
            out.time,
            touched,
            eye,
            moment.table,
            bound.bindings,
            bound.motions
        ],
        [
            splats.n as u32,
            splats.n_static as u32,
            bound.n as u32,
            splats.layout.isotropic
        ]
    );
}
