//! Bound splats on the device: the version in CubeCL.
//!
//! | file | what it does |
//! |---|---|
//! | `moment` | what kernels are told of the windows at an instant |
//! | `forward` | poses of nodes between keys, and the splats that they carry |
//! | `backward` | gradients of splats and nodes |
//! | `lists` | the splats that each node carries |
//!
//! What is drawn of a bound splat lies in columns of its own; the stages that follow take it from there and treat the splat as a static one.

use crate::launch;
use crate::{
    NodeGradients,
    adam::nodes::PARAMETERS,
    gpu::{
        Gpu, GpuError,
        buffer::{Buffer, cubes, units},
        splats::{DeviceSplats, gathered_columns},
    },
};
use cubecl::prelude::CubeDim;
use m4_core::{BINDING_NODES, Binding, Pose, Splats, Window};
pub(crate) use moment::Moment;
use std::sync::Arc;

mod backward;
mod forward;
mod lists;
mod moment;

const LEAST: f32 = super::LEAST_PRESENCE;

/// Numbers of a pose: position, rotation.
pub(crate) const POSE: usize = 7;
/// Numbers of a motion: quaternion, matrix row by row, shift.
pub(crate) const MOTION: usize = 16;
/// Columns of what is drawn of bound splats: mean, quaternion, logit of the opacity, constant colour.
pub(crate) const POSED: usize = 11;
/// Columns of a binding, floats as their bits: window,
pub(crate) const BINDING: usize = 11;
/// nodes among those of all windows,
const NODE: usize = 1;
/// weights,
const WEIGHT: usize = 5;
/// begin and end.
const LIFE: usize = 9;
/// In place of infinitely early or late, frames: kernels may not know infinity.
const FOREVER: f32 = 1e30;

/// What carries the bound splats of [`DeviceSplats`], and where they are.
#[derive(Debug, Clone)]
pub struct Bound {
    /// Bound splats: the first dynamic ones.
    pub n: usize,
    /// Their keys and anchors; poses are on the device.
    windows: Arc<Vec<Window>>,
    /// First node and first pose of each window.
    starts: Vec<[usize; 2]>,
    /// All of them.
    nodes: usize,
    pub(crate) poses: Buffer,
    anchors: Buffer,
    bindings: Buffer,
    /// Of each node, and one more.
    lists: [Buffer; 2],
    motions: Buffer,
    posed: Buffer,
    /// With respect to poses, six numbers each.
    pub(crate) gradients: Buffer,
}

impl Bound {
    /// Copies windows and bindings of `splats` to the device; `None` without windows.
    /// Fails with [`GpuError`] if they do not fit.
    pub fn upload(gpu: &Gpu, splats: &Splats) -> Result<Option<Self>, GpuError> {
        let (windows, client) = (splats.windows(), &gpu.client);
        if windows.is_empty() {
            return Ok(None);
        }
        let mut starts = Vec::with_capacity(windows.len());
        let (mut nodes, mut poses) = (0, 0);
        for window in windows.iter() {
            starts.push([nodes, poses]);
            nodes += window.anchors().len();
            poses += window.anchors().len() * window.keys().len();
        }
        let n = splats.bindings().len();
        gpu.fits("the poses of nodes", 4 * POSE * poses)?;
        gpu.fits("the bindings of splats", 4 * BINDING * n)?;
        let bindings = Buffer::words(client, &words(splats.bindings(), &starts));
        let anchors: Vec<f32> = windows.iter().flat_map(|w| w.anchors().as_flattened()).copied().collect();
        Ok(Some(Self {
            n,
            poses: Buffer::floats(client, &numbers(windows)),
            anchors: Buffer::floats(client, &anchors),
            lists: lists::lists(gpu, &bindings, n, nodes),
            bindings,
            motions: Buffer::empty(client, MOTION * nodes),
            posed: Buffer::empty(client, POSED * n),
            gradients: Buffer::empty(client, PARAMETERS * poses),
            windows: windows.clone(),
            starts,
            nodes,
        }))
    }

    /// The rows that `rows` names of splats of which the first bound one was `old_first`; `n` of them, from its number `first` on.
    #[must_use]
    pub fn gathered(&self, gpu: &Gpu, rows: &Buffer, old_first: usize, (first, n): (usize, usize)) -> Self {
        let bindings = gathered_columns(gpu, &self.bindings, rows, BINDING, (self.n, old_first), (n, first));
        let posed = if n == self.n { self.posed.clone() } else { Buffer::empty(&gpu.client, POSED * n) };
        Self { n, lists: lists::lists(gpu, &bindings, n, self.nodes), bindings, posed, ..self.clone() }
    }

    /// Waits, and gives windows and bindings to `splats`, whose first dynamic rows are bound. Fails with [`GpuError`] if the device failed.
    pub fn download(&self, gpu: &Gpu, splats: &mut Splats, doing: &'static str) -> Result<(), GpuError> {
        let poses = self.poses.read_floats(&gpu.client, doing)?;
        let mut poses = poses.as_chunks::<POSE>().0.iter();
        let mut windows = self.windows.as_ref().clone();
        for window in &mut windows {
            for key in 0..window.keys().len() {
                for (pose, &[x, y, z, a, b, c, d]) in window.poses_mut(key).iter_mut().zip(poses.by_ref()) {
                    *pose = Pose { position: [x, y, z], rotation: [a, b, c, d] };
                }
            }
        }
        let words = self.bindings.read_words(&gpu.client, doing)?;
        let bindings = (0..self.n).map(|i| self.binding(|column| words[column * self.n + i])).collect();
        Ok(splats.bind(Arc::new(windows), bindings)?)
    }

    /// A binding from its columns.
    fn binding(&self, word: impl Fn(usize) -> u32) -> Binding {
        let window = word(0);
        let first = self.starts.get(window as usize).map_or(0, |start| start[0] as u32);
        let float = |column: usize| f32::from_bits(word(column));
        let [begin, end] = [float(LIFE), float(LIFE + 1)];
        Binding {
            window,
            nodes: std::array::from_fn(|k| (word(NODE + k) - first) as u16),
            weights: std::array::from_fn(|k| float(WEIGHT + k)),
            life: [begin, end].map(|t| if t.abs() < FOREVER { t } else { f32::INFINITY.copysign(t) }),
        }
    }

    /// The windows, with the poses that were uploaded.
    pub fn windows(&self) -> &[Window] {
        &self.windows
    }

    /// The first pose at a key of a window, and how many there are.
    pub(crate) fn poses_at(&self, window: usize, key: usize) -> [usize; 2] {
        let nodes = self.windows[window].anchors().len();
        [self.starts[window][1] + key * nodes, nodes]
    }

    /// The bindings: `[11][n]`, the window first.
    pub(crate) fn bindings(&self) -> &Buffer {
        &self.bindings
    }

    /// What is drawn of bound splats: `[11][n]`.
    pub(crate) fn posed(&self) -> &Buffer {
        &self.posed
    }

    /// The numbers in each buffer of `n` bound splats and of `windows`, the moments of the nodes not among them.
    pub(crate) fn lengths(n: usize, windows: &[Window]) -> Vec<usize> {
        if windows.is_empty() {
            return Vec::new();
        }
        let (mut nodes, mut poses) = (0, 0);
        for window in windows {
            nodes += window.anchors().len();
            poses += window.anchors().len() * window.keys().len();
        }
        let tables = moment::WINDOW * windows.len() + windows.len();
        vec![
            POSE * poses,
            3 * nodes,
            BINDING * n,
            nodes + 1,
            4 * n,
            MOTION * nodes,
            POSED * n,
            PARAMETERS * poses,
            tables,
        ]
    }

    /// Carries the bound splats of `splats` to `t`, frames, the instant of `eye`. Gradients of nodes at `known` keys will be added to.
    pub(crate) fn pose(
        &self,
        gpu: &Gpu,
        splats: &DeviceSplats,
        eye: &Buffer,
        t: f32,
        known: &[(usize, usize)],
    ) -> Moment {
        let moment = Moment::new(gpu, &self.windows, &self.starts, t, known);
        let client = &gpu.client;
        let units_of_nodes = moment.active * moment.most;
        if units_of_nodes > 0 {
            launch!(
                client,
                forward::move_nodes::launch,
                (cubes(units_of_nodes, 256), units()),
                [self.poses, self.anchors, moment.table, self.motions],
                [self.list(), moment.active as u32, moment.most as u32]
            );
        }
        if self.n > 0 {
            launch!(
                client,
                forward::pose::launch,
                (cubes(self.n, 256), units()),
                [
                    splats.geometry,
                    splats.colour,
                    splats.time,
                    eye,
                    moment.table,
                    self.bindings,
                    self.motions,
                    self.posed
                ],
                [splats.n as u32, splats.n_static as u32, self.n as u32, splats.layout.isotropic]
            );
        }
        moment
    }

    /// Where the list of windows starts in a table.
    fn list(&self) -> u32 {
        (self.windows.len() * moment::WINDOW) as u32
    }

    /// Turns the gradients with respect to what was drawn of bound splats, in `out`, into those with respect to `splats`, and to the nodes at the
    /// keys of `moment`.
    pub(crate) fn backward(
        &self,
        gpu: &Gpu,
        splats: &DeviceSplats,
        out: &DeviceSplats,
        touched: &Buffer,
        eye: &Buffer,
        moment: &Moment,
    ) {
        if self.n == 0 {
            return;
        }
        let client = &gpu.client;
        if !moment.keys.is_empty() {
            launch!(
                client,
                backward::node_sums::launch,
                (cubes(moment.active * moment.most, 1), CubeDim::new_1d(backward::UNITS as u32)),
                [
                    splats.geometry,
                    splats.time,
                    out.geometry,
                    touched,
                    eye,
                    moment.table,
                    self.bindings,
                    self.motions,
                    self.anchors,
                    self.lists[0],
                    self.lists[1],
                    self.gradients
                ],
                [
                    splats.n as u32,
                    splats.n_static as u32,
                    self.n as u32,
                    self.list(),
                    moment.active as u32,
                    moment.most as u32,
                    splats.layout.isotropic
                ]
            );
        }
        launch!(
            client,
            backward::own_gradients::launch,
            (cubes(self.n, 256), units()),
            [
                splats.geometry,
                splats.time,
                out.geometry,
                out.colour,
                out.time,
                touched,
                eye,
                moment.table,
                self.bindings,
                self.motions
            ],
            [splats.n as u32, splats.n_static as u32, self.n as u32, splats.layout.isotropic]
        );
    }

    /// Waits, and returns the gradients of the nodes at these keys. Fails with [`GpuError`] if the device failed.
    pub(crate) fn node_gradients(
        &self,
        gpu: &Gpu,
        keys: &[(usize, usize)],
        doing: &'static str,
    ) -> Result<Vec<NodeGradients>, GpuError> {
        let all = self.gradients.read_floats(&gpu.client, doing)?;
        let all = all.as_chunks::<PARAMETERS>().0;
        let one = |&(window, key): &(usize, usize)| {
            let [first, nodes] = self.poses_at(window, key);
            NodeGradients { window, key, nodes: all[first..first + nodes].to_vec() }
        };
        Ok(keys.iter().map(one).collect())
    }
}

/// The poses of all windows, keys and nodes.
fn numbers(windows: &[Window]) -> Vec<f32> {
    let keys = windows.iter().flat_map(|w| (0..w.keys().len()).map(move |key| w.poses(key)));
    let numbers = |pose: &Pose| pose.position.into_iter().chain(pose.rotation);
    keys.flatten().flat_map(numbers).collect()
}

/// The columns of bindings.
fn words(bindings: &[Binding], starts: &[[usize; 2]]) -> Vec<u32> {
    let finite = |t: f32| t.clamp(-FOREVER, FOREVER).to_bits();
    let column = |c: usize| {
        bindings.iter().map(move |b| match c {
            0 => b.window,
            1..5 => (starts[b.window as usize][0] + usize::from(b.nodes[c - NODE])) as u32,
            5..9 => b.weights[c - WEIGHT].to_bits(),
            _ => finite(b.life[c - LIFE]),
        })
    };
    const { assert!(NODE + BINDING_NODES == WEIGHT && WEIGHT + BINDING_NODES == LIFE && LIFE + 2 == BINDING) }
    (0..BINDING).flat_map(column).collect()
}
