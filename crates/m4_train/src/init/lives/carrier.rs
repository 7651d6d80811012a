//! The nodes that carry a point, and where it is when they have not moved.

use crate::init::motion::Rigid;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_core::{
    BINDING_NODES,
    nalgebra::{Matrix3, UnitQuaternion, Vector3},
};
use std::num::NonZero;

/// A node carries what is within this many times the distance of nodes.
const REACH: f32 = 4.0;
const MOST: NonZero<usize> = NonZero::new(BINDING_NODES).unwrap();

/// What carries a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Carrier {
    /// The nearest first: signs of rotations follow it.
    pub nodes: [u16; BINDING_NODES],
    pub weights: [f32; BINDING_NODES],
    /// Where the point is when nodes have not moved, world units.
    pub mean: Vector3<f32>,
    /// Its rotation since then, `(w, x, y, z)`, of length 1.
    pub turn: [f32; 4],
}

impl Carrier {
    /// Of a place among nodes that `motions` have brought to where `tree` knows them, `spacing` apart. `None` far from all of them.
    pub fn new(tree: &ImmutableKdTree<f32, 3>, motions: &[Rigid], p: [f32; 3], spacing: f32) -> Option<Self> {
        let mut near = tree.query(&p).nearest_n::<SquaredEuclidean<f32>>(MOST).execute();
        near.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.item.cmp(&b.item)));
        let nearest = near.first().filter(|n| n.distance <= (REACH * spacing).powi(2))?;
        let (mut nodes, mut weights) = ([nearest.item as u16; BINDING_NODES], [0.0; BINDING_NODES]);
        for (k, n) in near.iter().enumerate().take(BINDING_NODES) {
            nodes[k] = n.item as u16;
            weights[k] = (-(n.distance - nearest.distance) / (spacing * spacing)).exp();
        }
        let total: f32 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= total);
        let quat = |q: &UnitQuaternion<f32>| [q.w, q.i, q.j, q.k];
        let first = quat(&motions[usize::from(nodes[0])].rotation);
        let (mut matrix, mut shift, mut turn) = (Matrix3::zeros(), Vector3::zeros(), [0.0f32; 4]);
        for (&node, &w) in nodes.iter().zip(&weights) {
            let m = &motions[usize::from(node)];
            matrix += m.rotation.to_rotation_matrix().matrix() * w;
            shift += m.moved(&Vector3::zeros()) * w;
            let own = quat(&m.rotation);
            let side: f32 = (0..4).map(|k| own[k] * first[k]).sum();
            (0..4).for_each(|k| turn[k] += w * side.signum() * own[k]);
        }
        let mean = matrix.try_inverse()? * (Vector3::from(p) - shift);
        let length = turn.iter().map(|v| v * v).sum::<f32>().sqrt();
        let finite = mean.iter().all(|v| v.is_finite()) && length > 0.0;
        finite.then_some(Self { nodes, weights, mean, turn: turn.map(|v| v / length) })
    }

    /// Where motions carry the point.
    pub fn place(&self, motions: &[Rigid]) -> Vector3<f32> {
        carried(motions, &self.nodes, &self.weights, &self.mean)
    }
}

/// Where motions of nodes carry a place.
pub(super) fn carried(
    motions: &[Rigid],
    nodes: &[u16; BINDING_NODES],
    weights: &[f32; BINDING_NODES],
    p: &Vector3<f32>,
) -> Vector3<f32> {
    nodes.iter().zip(weights).map(|(&node, &w)| motions[usize::from(node)].moved(p) * w).sum()
}
