//! Rigid motions of point clouds, and the grouping of points into rigid bodies.

use m4_core::nalgebra::{Matrix3, UnitQuaternion, Vector3};
use std::collections::BTreeMap;

/// `p -> to + rotation (p - from)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rigid {
    pub rotation: UnitQuaternion<f32>,
    pub from: Vector3<f32>,
    pub to: Vector3<f32>,
}

/// Where a point was, where it went, and how much that counts.
pub(crate) type Pair = (Vector3<f32>, Vector3<f32>, f32);

impl Rigid {
    /// A shift that takes `from` to `to`.
    pub fn shift(from: [f32; 3], to: [f32; 3]) -> Self {
        Self { rotation: UnitQuaternion::identity(), from: from.into(), to: to.into() }
    }

    /// The rigid motion that fits `pairs` best in the least squares; `None` if their weight is 0.
    ///
    /// The rotation is the rotational part of the cross-covariance (Müller et al. 2016, "A robust method to
    /// extract the rotational part of deformations"), found by turning `start` until nothing is left to turn.
    /// Where the points say nothing (a line, a single point) it stays at `start`.
    pub fn fit(pairs: impl Iterator<Item = Pair>, start: UnitQuaternion<f32>) -> Option<Self> {
        let mut pairs = pairs.peekable();
        // from here, or the sums would lose digits
        let origin = pairs.peek()?.0;
        let (mut from, mut to, mut total) = (Vector3::zeros(), Vector3::zeros(), 0.0f32);
        let mut a = Matrix3::<f32>::zeros();
        for (p, q, w) in pairs {
            let (p, q) = (p - origin, w * (q - origin));
            from += w * p;
            to += q;
            a += q * p.transpose();
            total += w;
        }
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        from /= total;
        to /= total;
        a = a / total - to * from.transpose();
        from += origin;
        to += origin;
        // the turn does not depend on the unit of length
        let size = a.norm();
        let mut rotation = start;
        if size > 0.0 {
            a /= size;
            for _ in 0..ROUNDS {
                let r = rotation.to_rotation_matrix();
                let r = r.matrix();
                let (mut turn, mut along) = (Vector3::zeros(), 0.0);
                for k in 0..3 {
                    turn += r.column(k).cross(&a.column(k));
                    along += r.column(k).dot(&a.column(k));
                }
                let step = turn / (along.abs() + 1e-6);
                if step.norm_squared() < 1e-10 {
                    break;
                }
                rotation = UnitQuaternion::from_scaled_axis(step) * rotation;
                rotation.renormalize_fast();
            }
        }
        Some(Self { rotation, from, to })
    }

    /// The motion back.
    pub fn inverse(&self) -> Self {
        Self { rotation: self.rotation.inverse(), from: self.to, to: self.from }
    }

    /// Returns the transformed point.
    pub fn apply(&self, p: [f32; 3]) -> [f32; 3] {
        (self.to + self.rotation * (Vector3::from(p) - self.from)).into()
    }
}

/// Steps towards the best rotation; each takes about two digits off what is left.
const ROUNDS: usize = 12;

/// A number for the body of every point: points in the same or in touching cells of edge `gap` (world units) are
/// one body. Bodies are numbered from 0, in the order of their first points.
pub(crate) fn bodies(points: impl Iterator<Item = [f32; 3]>, gap: f32) -> Vec<usize> {
    let cells: Vec<[i32; 3]> = points.map(|p| p.map(|v| (v / gap).floor() as i32)).collect();
    let mut of_cell: BTreeMap<[i32; 3], usize> = BTreeMap::new();
    for cell in &cells {
        let next = of_cell.len();
        of_cell.entry(*cell).or_insert(next);
    }
    let mut parent: Vec<usize> = (0..of_cell.len()).collect();
    for (cell, &i) in &of_cell {
        for step in 0..27 {
            let [x, y, z] = [step % 3 - 1, step / 3 % 3 - 1, step / 9 - 1];
            let other = [cell[0].saturating_add(x), cell[1].saturating_add(y), cell[2].saturating_add(z)];
            if let Some(&j) = of_cell.get(&other) {
                let (a, b) = (root(&mut parent, i), root(&mut parent, j));
                parent[a.max(b)] = a.min(b);
            }
        }
    }
    let mut number: BTreeMap<usize, usize> = BTreeMap::new();
    cells
        .iter()
        .map(|cell| {
            let body = root(&mut parent, of_cell[cell]);
            let next = number.len();
            *number.entry(body).or_insert(next)
        })
        .collect()
}

fn root(parent: &mut [usize], mut i: usize) -> usize {
    while parent[i] != i {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    i
}

#[cfg(test)]
mod tests {
    use super::{Rigid, bodies};
    use m4_core::{
        CounterRng,
        nalgebra::{UnitQuaternion, Vector3},
    };

    #[test]
    fn a_large_turn_is_recovered_exactly() {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.9, -1.1, 0.4));
        let mut rng = CounterRng::new(1, 2, 3);
        let pairs: Vec<_> = (0..40)
            .map(|_| {
                let p = Vector3::from([0, 1, 2].map(|_| rng.uniform() as f32));
                (p, turn * p + Vector3::new(3.0, 0.0, -1.0), rng.uniform() as f32)
            })
            .collect();
        let fit = Rigid::fit(pairs.iter().copied(), UnitQuaternion::identity()).unwrap();
        for (p, q, _) in &pairs {
            assert!((Vector3::from(fit.apply((*p).into())) - q).norm() < 1e-4);
            assert!((Vector3::from(fit.inverse().apply((*q).into())) - p).norm() < 1e-4);
        }
    }

    #[test]
    fn one_point_gives_a_translation_and_none_gives_no_motion() {
        let start = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.2, 0.0));
        let (p, q) = (Vector3::new(1.0, 2.0, 3.0), Vector3::new(4.0, 4.0, 4.0));
        let fit = Rigid::fit([(p, q, 1.0)].into_iter(), start).unwrap();
        assert_eq!(fit.rotation, start);
        assert!((Vector3::from(fit.apply(p.into())) - q).norm() < 1e-6);
        assert!(Rigid::fit([(p, q, 0.0)].into_iter(), start).is_none());
        assert!(Rigid::fit(std::iter::empty(), start).is_none());
    }

    #[test]
    fn a_chain_is_one_body_and_a_gap_makes_two() {
        let chain = (0..20).map(|i| [0.9 * i as f32, -3.0, 0.5 * i as f32]);
        let far = (0..3).map(|i| [50.0, i as f32, 0.0]);
        let got = bodies(far.chain(chain), 1.0);
        assert_eq!(got[..3], [0; 3]);
        assert_eq!(got[3..], [1; 20]);
        assert!(bodies(std::iter::empty(), 1.0).is_empty());
    }

    #[test]
    fn infinite_and_nan_positions_do_not_panic() {
        let got = bodies([[f32::NAN; 3], [1e30, -1e30, 0.0], [f32::INFINITY; 3]].into_iter(), 1e-3);
        assert_eq!(got.len(), 3);
    }
}
