//! One step of the nodes that carry splats, at the keys that frames showed: the version in CubeCL
//! of [`crate::adam::nodes`].

use crate::NODE_PARAMETERS;
use crate::adam::cpu::AdamConfig;
use crate::adam::nodes::{NodeMoments, NodeRates};
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::tally::{Tally, check_parameter};
use crate::gpu::{Gpu, GpuError};
use crate::launch;
use crate::splats::{Bound, POSE};
use cubecl::prelude::*;
use m4_core::{ShapeError, Window};

/// The moments of the nodes of all windows on the device.
#[derive(Debug, Clone)]
pub struct DeviceNodes {
    /// First moments, six of each pose.
    m: Buffer,
    /// Second moments, likewise.
    v: Buffer,
    /// Steps of the keys of each window.
    steps: Buffer,
    /// Numbers and keys.
    shape: [usize; 2],
}

impl DeviceNodes {
    /// Copies the moments of each window to the device. Fails with [`GpuError`] if they do not fit.
    pub fn upload(gpu: &Gpu, nodes: &[NodeMoments]) -> Result<Self, GpuError> {
        let joined = |of: fn(&NodeMoments) -> &Vec<f32>| {
            nodes.iter().flat_map(of).copied().collect::<Vec<f32>>()
        };
        let (m, v) = (joined(|nodes| &nodes.m), joined(|nodes| &nodes.v));
        gpu.fits("the moments of nodes", 4 * m.len())?;
        let steps: Vec<u32> = nodes
            .iter()
            .flat_map(|nodes| &nodes.step)
            .copied()
            .collect();
        let client = &gpu.client;
        Ok(Self {
            m: Buffer::floats(client, &m),
            v: Buffer::floats(client, &v),
            steps: Buffer::words(client, &steps),
            shape: [m.len(), steps.len()],
        })
    }

    /// Waits, and copies them back. Fails with [`GpuError`] if the device failed.
    pub fn download(
        &self,
        gpu: &Gpu,
        windows: &[Window],
        doing: &'static str,
    ) -> Result<Vec<NodeMoments>, GpuError> {
        let m = self.m.read_floats(&gpu.client, doing)?;
        let v = self.v.read_floats(&gpu.client, doing)?;
        let steps = self.steps.read_words(&gpu.client, doing)?;
        let (mut first, mut key) = (0, 0);
        let mut out = Vec::with_capacity(windows.len());
        for window in windows {
            let keys = window.keys().len();
            let len = NODE_PARAMETERS * keys * window.anchors().len();
            out.push(NodeMoments {
                step: steps[key..key + keys].to_vec(),
                m: m[first..first + len].to_vec(),
                v: v[first..first + len].to_vec(),
            });
            (first, key) = (first + len, key + keys);
        }
        Ok(out)
    }

    /// Fails with [`ShapeError`] unless these are the moments of windows like `windows`.
    pub fn fit(&self, windows: &[Window]) -> Result<(), ShapeError> {
        let (mut numbers, mut keys) = (0, 0);
        for window in windows {
            keys += window.keys().len();
            numbers += NODE_PARAMETERS * window.keys().len() * window.anchors().len();
        }
        ShapeError::check("numbers of nodes of the optimiser", numbers, self.shape[0])?;
        ShapeError::check("keys of windows of the optimiser", keys, self.shape[1])
    }

    /// Fails with [`ShapeError`] unless these are moments of `windows`.
    pub fn check(nodes: &[NodeMoments], windows: &[Window]) -> Result<(), ShapeError> {
        ShapeError::check("windows of the optimiser", windows.len(), nodes.len())?;
        for (nodes, window) in nodes.iter().zip(windows) {
            let keys = window.keys().len();
            let len = NODE_PARAMETERS * keys * window.anchors().len();
            ShapeError::check("keys of the optimiser", keys, nodes.step.len())?;
            ShapeError::check("nodes of the optimiser", len, nodes.m.len())?;
            ShapeError::check("nodes of the optimiser", len, nodes.v.len())?;
        }
        Ok(())
    }

    /// One step of the nodes at these keys of windows along the gradients that `bound` has; those
    /// of keys and nodes that are all 0 stay. `tally` notes parameters that are not finite.
    pub fn step(
        &self,
        gpu: &Gpu,
        bound: &Bound,
        keys: &[(usize, usize)],
        tally: &Tally,
        config: &AdamConfig,
        rates: NodeRates,
    ) {
        if keys.is_empty() {
            return;
        }
        let mut table = Vec::with_capacity(3 * keys.len());
        for &(window, key) in keys {
            let before: usize = bound.windows()[..window]
                .iter()
                .map(|w| w.keys().len())
                .sum();
            let [first, nodes] = bound.poses_at(window, key);
            table.extend([first as u32, nodes as u32, (before + key) as u32]);
        }
        let client = &gpu.client;
        launch!(
            client,
            step_nodes::launch,
            (cubes(keys.len(), 1), units()),
            [
                bound.poses,
                bound.gradients,
                self.m,
                self.v,
                self.steps,
                gpu.input(&table),
                tally.buffer
            ],
            [
                keys.len() as u32,
                config.beta1 as f32,
                config.beta2_dynamic as f32,
                config.eps as f32,
                rates.position,
                rates.turn
            ]
        );
    }
}

/// A step of the nodes at a key, a cube a key; `table` holds the first pose, the number of nodes,
/// and the number of the key.
#[cube(launch)]
fn step_nodes(
    poses: &mut [f32],
    gradients: &[f32],
    m: &mut [f32],
    v: &mut [f32],
    steps: &mut [u32],
    table: &[u32],
    tally: &[Atomic<u32>],
    keys: u32,
    beta1: f32,
    beta2: f32,
    epsilon: f32,
    rate: f32,
    turn_rate: f32,
) {
    let mut shared = Shared::<[u32]>::new_slice(256usize);
    let cube = CUBE_POS as u32;
    if cube < keys {
        let at = 3 * cube as usize;
        let (first, nodes, key) = (table[at], table[at + 1], table[at + 2] as usize);
        let mut any = 0u32;
        let mut node = UNIT_POS;
        while node < nodes {
            if has_gradient(gradients, first + node) {
                any = 1u32;
            }
            node += 256u32;
        }
        shared[UNIT_POS as usize] = any;
        sync_cube();
        let mut half = 128u32;
        while half > 0u32 {
            if UNIT_POS < half {
                shared[UNIT_POS as usize] |= shared[(UNIT_POS + half) as usize];
            }
            sync_cube();
            half /= 2u32;
        }
        let count = steps[key] + 1u32;
        sync_cube();
        if shared[0] != 0u32 {
            if UNIT_POS == 0u32 {
                steps[key] = count;
            }
            let n_steps = f32::cast_from(count);
            let bias1 = 1.0f32 / (1.0f32 - (n_steps * beta1.ln()).exp());
            let bias2 = 1.0f32 / (1.0f32 - (n_steps * beta2.ln()).exp());
            let mut node = UNIT_POS;
            while node < nodes {
                if has_gradient(gradients, first + node) {
                    let pose = (first + node) as usize * POSE;
                    let from = (first + node) as usize * NODE_PARAMETERS;
                    let mut moves = Array::<f32>::new(NODE_PARAMETERS);
                    #[unroll]
                    for k in 0usize..NODE_PARAMETERS {
                        let g = gradients[from + k];
                        let mean = beta1 * m[from + k] + (1.0f32 - beta1) * g;
                        let square = beta2 * v[from + k] + (1.0f32 - beta2) * g * g;
                        m[from + k] = mean;
                        v[from + k] = square;
                        let mut step = rate;
                        if comptime!(k >= 3) {
                            step = turn_rate;
                        }
                        moves[k] = step * mean * bias1 / ((square * bias2).sqrt() + epsilon);
                    }
                    #[unroll]
                    for k in 0usize..3usize {
                        let moved = poses[pose + k] - moves[k];
                        poses[pose + k] = moved;
                        check_parameter(moved, tally);
                    }
                    turn(poses, pose + 3, -moves[3], -moves[4], -moves[5], tally);
                }
                node += 256u32;
            }
        }
    }
}

/// Whether one of the six numbers of a pose is not 0.
#[cube]
fn has_gradient(gradients: &[f32], pose: u32) -> bool {
    let from = pose as usize * NODE_PARAMETERS;
    let mut any = false;
    #[unroll]
    for k in 0usize..NODE_PARAMETERS {
        if gradients[from + k] != 0.0f32 {
            any = true;
        }
    }
    any
}

/// Turns the quaternion at `at` by a rotation vector, in world axes.
#[cube]
fn turn(poses: &mut [f32], at: usize, x: f32, y: f32, z: f32, tally: &[Atomic<u32>]) {
    let angle = (x * x + y * y + z * z).sqrt();
    let a = (0.5f32 * angle).cos();
    let mut along = 0.5f32;
    if angle > 0.0f32 {
        along = (0.5f32 * angle).sin() / angle;
    }
    let (b, c, d) = (along * x, along * y, along * z);
    let (qw, qx, qy, qz) = (poses[at], poses[at + 1], poses[at + 2], poses[at + 3]);
    let nw = a * qw - b * qx - c * qy - d * qz;
    let nx = a * qx + b * qw + c * qz - d * qy;
    let ny = a * qy - b * qz + c * qw + d * qx;
    let nz = a * qz + b * qy - c * qx + d * qw;
    let length = (nw * nw + nx * nx + ny * ny + nz * nz).sqrt();
    poses[at] = nw / length;
    poses[at + 1] = nx / length;
    poses[at + 2] = ny / length;
    poses[at + 3] = nz / length;
    check_parameter(nw / length, tally);
}
