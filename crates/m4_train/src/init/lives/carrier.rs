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
/// Nodes that turn farther from the nearest than this, radians, at any keyframe are of another
/// piece: a blend with them would shrink the surface (our rule; docs/decisions/0022).
const OTHER_TURN: f32 = 0.7;
const MOST: NonZero<usize> = NonZero::new(BINDING_NODES).unwrap();

/// What carries a point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Carrier {
    /// The nearest first: signs of rotations follow it.
    pub nodes: [u16; BINDING_NODES],
    pub weights: [f32; BINDING_NODES],
    /// Where the point is when nodes have not moved, world units.
    pub mean: Vector3<f32>,
    /// Its rotation since then, `(w, x, y, z)`, of length 1.
    pub turn: [f32; 4],
}

impl Carrier {
    /// Of a place of keyframe `at` among nodes, `spacing` apart, that `motion`
    /// (`[keyframes][nodes]`) has brought to where `tree` knows them. `None` far from all of them.
    pub fn new(
        tree: &ImmutableKdTree<f32, 3>,
        motion: &[Vec<Rigid>],
        at: usize,
        p: [f32; 3],
        spacing: f32,
    ) -> Option<Self> {
        let motions = &motion[at];
        let mut near = tree
            .query(&p)
            .nearest_n::<SquaredEuclidean<f32>>(MOST)
            .execute();
        near.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.item.cmp(&b.item)));
        let nearest = near
            .first()
            .filter(|n| n.distance <= (REACH * spacing).powi(2))?;
        let (mut nodes, mut weights) = ([nearest.item as u16; BINDING_NODES], [0.0; BINDING_NODES]);
        for (k, n) in near.iter().enumerate().take(BINDING_NODES) {
            nodes[k] = n.item as u16;
            if !turn_alike(motion, nearest.item as usize, n.item as usize) {
                continue;
            }
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
        finite.then_some(Self {
            nodes,
            weights,
            mean,
            turn: turn.map(|v| v / length),
        })
    }

    /// Where motions carry the point.
    pub fn place(&self, motions: &[Rigid]) -> Vector3<f32> {
        carried(motions, &self.nodes, &self.weights, &self.mean)
    }
}

/// Whether two nodes never turn apart by more than [`OTHER_TURN`].
fn turn_alike(motion: &[Vec<Rigid>], a: usize, b: usize) -> bool {
    let least = (0.5 * OTHER_TURN).cos();
    motion
        .iter()
        .all(|nodes| nodes[a].rotation.dot(&nodes[b].rotation).abs() >= least)
}

/// Where motions of nodes carry a place.
pub(super) fn carried(
    motions: &[Rigid],
    nodes: &[u16; BINDING_NODES],
    weights: &[f32; BINDING_NODES],
    p: &Vector3<f32>,
) -> Vector3<f32> {
    nodes
        .iter()
        .zip(weights)
        .map(|(&node, &w)| motions[usize::from(node)].moved(p) * w)
        .sum()
}

#[cfg(test)]
mod tests {
    use super::Carrier;
    use crate::init::motion::Rigid;
    use kiddo::ImmutableKdTree;
    use m4_core::nalgebra::{UnitQuaternion, Vector3};

    /// A row of four nodes 0.1 apart; the last two turn the other way about z, by up to `rad` at
    /// the second of two keyframes.
    fn motion(rad: f32) -> (Vec<[f32; 3]>, Vec<Vec<Rigid>>) {
        let places: Vec<[f32; 3]> = (0..4).map(|k| [0.1 * k as f32, 0.0, 2.0]).collect();
        let key = |share: f32| {
            let turned = |(k, p): (usize, &[f32; 3])| {
                let angle = if k < 2 {
                    0.5 * rad * share
                } else {
                    -0.5 * rad * share
                };
                let rotation = UnitQuaternion::from_scaled_axis(Vector3::z() * angle);
                Rigid {
                    rotation,
                    from: (*p).into(),
                    to: (*p).into(),
                }
            };
            places.iter().enumerate().map(turned).collect()
        };
        let keys = vec![key(0.0), key(1.0)];
        (places, keys)
    }

    #[test]
    fn nodes_that_turn_otherwise_do_not_carry() {
        for (rad, together) in [(0.3, true), (3.1, false)] {
            let (places, motion) = motion(rad);
            let tree = ImmutableKdTree::<f32, 3>::new_from_slice(&places).unwrap();
            for at in [0, 1] {
                let p = [0.13, 0.02, 2.0];
                let carrier = Carrier::new(&tree, &motion, at, p, 0.1).unwrap();
                let others = carrier
                    .nodes
                    .iter()
                    .zip(carrier.weights)
                    .filter(|(node, _)| **node > 1);
                assert_eq!(others.map(|(_, w)| w).sum::<f32>() > 0.1, together);
                assert!((carrier.weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
                assert!(
                    (carrier.place(&motion[at]) - Vector3::from(p)).norm() < 1e-5,
                    "it is back where it is"
                );
                assert!(
                    (carrier.mean - Vector3::from(p)).norm() < 0.2,
                    "{:?}",
                    carrier.mean
                );
            }
        }
        let (places, motion) = motion(0.0);
        let tree = ImmutableKdTree::<f32, 3>::new_from_slice(&places).unwrap();
        assert!(
            Carrier::new(&tree, &motion, 0, [0.0, 1.0, 2.0], 0.1).is_none(),
            "far from all"
        );
    }
}
