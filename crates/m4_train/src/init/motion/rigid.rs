//! Rigid motions of point clouds.

use m4_core::nalgebra::{Matrix3, UnitQuaternion, Vector3};

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
        Self {
            rotation: UnitQuaternion::identity(),
            from: from.into(),
            to: to.into(),
        }
    }

    /// The rigid motion that fits `pairs` best in the least squares; `None` if their weight is 0.
    ///
    /// The rotation is the rotational part of the cross-covariance (Müller et al. 2016, "A robust
    /// method to extract the rotational part of deformations"), found by turning `start` until
    /// nothing is left to turn. Where the points say nothing (a line, a single point) it stays at
    /// `start`.
    pub fn fit(pairs: impl Iterator<Item = Pair>, start: UnitQuaternion<f32>) -> Option<Self> {
        let mut pairs = pairs.peekable();
        // from here, or the sums would lose digits
        let origin = pairs.peek()?.0;
        // sums of the weighted `(to, 1)`: alone, and with each component of `from`; four lanes are
        // one instruction
        let mut sums = [[0.0f32; 4]; 4];
        for (p, q, w) in pairs {
            let (p, q) = (p - origin, q - origin);
            let to = [w * q.x, w * q.y, w * q.z, w];
            for (sum, by) in sums.iter_mut().zip([1.0, p.x, p.y, p.z]) {
                (0..4).for_each(|k| sum[k] += to[k] * by);
            }
        }
        let [[x, y, z, total], rest @ ..] = sums;
        let mut to = Vector3::new(x, y, z);
        let mut from = Vector3::from(rest.map(|sum| sum[3]));
        let mut a = Matrix3::from_fn(|i, j| rest[j][i]);
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
        Self {
            rotation: self.rotation.inverse(),
            from: self.to,
            to: self.from,
        }
    }

    /// Returns the transformed point.
    pub fn apply(&self, p: [f32; 3]) -> [f32; 3] {
        self.moved(&p.into()).into()
    }

    /// Returns the transformed point.
    pub fn moved(&self, p: &Vector3<f32>) -> Vector3<f32> {
        self.to + self.rotation * (p - self.from)
    }

    /// The same motion, told by another point.
    pub fn about(&self, p: [f32; 3]) -> Self {
        Self {
            from: p.into(),
            to: self.moved(&p.into()),
            ..*self
        }
    }
}

/// Steps towards the best rotation; each takes about two digits off what is left.
const ROUNDS: usize = 12;

#[cfg(test)]
mod tests {
    use super::Rigid;
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
                (
                    p,
                    turn * p + Vector3::new(3.0, 0.0, -1.0),
                    rng.uniform() as f32,
                )
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
}
