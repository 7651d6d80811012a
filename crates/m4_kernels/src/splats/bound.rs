//! What carries bound splats: windows, the poses of their nodes, and what binds each splat to them.

use super::{gathered_columns, lists::lists};
use crate::gpu::buffer::Buffer;
use crate::gpu::{Gpu, GpuError};
use crate::{NODE_PARAMETERS, NodeGradients};
use m4_core::{BINDING_NODES, Binding, Pose, Splats, Window};
use std::sync::Arc;

/// Numbers of a pose: position, rotation.
pub(crate) const POSE: usize = 7;
/// Numbers of a motion: quaternion, matrix row by row, shift.
pub(crate) const MOTION: usize = 16;
/// Columns of what is drawn of bound splats: mean, quaternion, logit of the opacity, constant
/// colour.
const POSED: usize = 11;
/// Columns of a binding, floats as their bits: window,
const BINDING: usize = 11;
/// nodes among those of all windows,
pub(crate) const NODE: usize = 1;
/// weights,
pub(crate) const WEIGHT: usize = 5;
/// begin and end.
pub(crate) const LIFE: usize = 9;
/// In place of infinitely early or late, frames: kernels may not know infinity.
const FOREVER: f32 = 1e30;

/// What carries the bound splats of [`DeviceSplats`](super::DeviceSplats), and where they are.
#[derive(Debug, Clone)]
pub struct Bound {
    /// Bound splats: the first dynamic ones.
    pub n: usize,
    /// Their keys and anchors; poses are on the device.
    pub(crate) windows: Arc<Vec<Window>>,
    /// First node and first pose of each window.
    pub(crate) starts: Vec<[usize; 2]>,
    /// All of them.
    nodes: usize,
    pub(crate) poses: Buffer,
    pub(crate) anchors: Buffer,
    pub(crate) bindings: Buffer,
    /// Of each node, and one more.
    pub(crate) lists: [Buffer; 2],
    pub(crate) motions: Buffer,
    pub(crate) posed: Buffer,
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
        let anchors: Vec<f32> = windows
            .iter()
            .flat_map(|w| w.anchors().as_flattened())
            .copied()
            .collect();
        Ok(Some(Self {
            n,
            poses: Buffer::floats(client, &numbers(windows)),
            anchors: Buffer::floats(client, &anchors),
            lists: lists(gpu, &bindings, n, nodes),
            bindings,
            motions: Buffer::empty(client, MOTION * nodes),
            posed: Buffer::empty(client, POSED * n),
            gradients: Buffer::empty(client, NODE_PARAMETERS * poses),
            windows: windows.clone(),
            starts,
            nodes,
        }))
    }

    /// The rows that `rows` names of splats of which the first bound one was `old_first`; `n` of
    /// them, from its number `first` on.
    #[must_use]
    pub fn gathered(
        &self,
        gpu: &Gpu,
        rows: &Buffer,
        old_first: usize,
        (first, n): (usize, usize),
    ) -> Self {
        let bindings = gathered_columns(
            gpu,
            &self.bindings,
            rows,
            BINDING,
            (self.n, old_first),
            (n, first),
        );
        let posed = if n == self.n {
            self.posed.clone()
        } else {
            Buffer::empty(&gpu.client, POSED * n)
        };
        Self {
            n,
            lists: lists(gpu, &bindings, n, self.nodes),
            bindings,
            posed,
            ..self.clone()
        }
    }

    /// Waits, and gives windows and bindings to `splats`, whose first dynamic rows are bound. Fails
    /// with [`GpuError`] if the device failed.
    pub fn download(
        &self,
        gpu: &Gpu,
        splats: &mut Splats,
        doing: &'static str,
    ) -> Result<(), GpuError> {
        let poses = self.poses.read_floats(&gpu.client, doing)?;
        let mut poses = poses.as_chunks::<POSE>().0.iter();
        let mut windows = self.windows.as_ref().clone();
        for window in &mut windows {
            for key in 0..window.keys().len() {
                for (pose, &[x, y, z, a, b, c, d]) in
                    window.poses_mut(key).iter_mut().zip(poses.by_ref())
                {
                    *pose = Pose {
                        position: [x, y, z],
                        rotation: [a, b, c, d],
                    };
                }
            }
        }
        let words = self.bindings.read_words(&gpu.client, doing)?;
        let bindings = (0..self.n)
            .map(|i| self.binding(|column| words[column * self.n + i]))
            .collect();
        Ok(splats.bind(Arc::new(windows), bindings)?)
    }

    /// A binding from its columns.
    fn binding(&self, word: impl Fn(usize) -> u32) -> Binding {
        let window = word(0);
        let first = self
            .starts
            .get(window as usize)
            .map_or(0, |start| start[0] as u32);
        let float = |column: usize| f32::from_bits(word(column));
        let [begin, end] = [float(LIFE), float(LIFE + 1)];
        Binding {
            window,
            nodes: std::array::from_fn(|k| (word(NODE + k) - first) as u16),
            weights: std::array::from_fn(|k| float(WEIGHT + k)),
            life: [begin, end].map(|t| {
                if t.abs() < FOREVER {
                    t
                } else {
                    f32::INFINITY.copysign(t)
                }
            }),
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

    /// The numbers in each buffer of `n` bound splats and of `windows`; neither the moments of the
    /// nodes nor the table of an instant are among them.
    pub(crate) fn lengths(n: usize, windows: &[Window]) -> Vec<usize> {
        if windows.is_empty() {
            return Vec::new();
        }
        let (mut nodes, mut poses) = (0, 0);
        for window in windows {
            nodes += window.anchors().len();
            poses += window.anchors().len() * window.keys().len();
        }
        vec![
            POSE * poses,
            3 * nodes,
            BINDING * n,
            nodes + 1,
            4 * n,
            MOTION * nodes,
            POSED * n,
            NODE_PARAMETERS * poses,
        ]
    }

    /// Waits, and returns the gradients of the nodes at these keys. Fails with [`GpuError`] if the
    /// device failed.
    pub(crate) fn node_gradients(
        &self,
        gpu: &Gpu,
        keys: &[(usize, usize)],
        doing: &'static str,
    ) -> Result<Vec<NodeGradients>, GpuError> {
        let all = self.gradients.read_floats(&gpu.client, doing)?;
        let all = all.as_chunks::<NODE_PARAMETERS>().0;
        let one = |&(window, key): &(usize, usize)| {
            let [first, nodes] = self.poses_at(window, key);
            NodeGradients {
                window,
                key,
                nodes: all[first..first + nodes].to_vec(),
            }
        };
        Ok(keys.iter().map(one).collect())
    }
}

/// The poses of all windows, keys and nodes.
fn numbers(windows: &[Window]) -> Vec<f32> {
    let keys = windows
        .iter()
        .flat_map(|w| (0..w.keys().len()).map(move |key| w.poses(key)));
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
    const {
        assert!(
            NODE + BINDING_NODES == WEIGHT && WEIGHT + BINDING_NODES == LIFE && LIFE + 2 == BINDING
        )
    }
    (0..BINDING).flat_map(column).collect()
}
