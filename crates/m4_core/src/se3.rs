//! Rigid motions with a left retraction.

use crate::Real;
use nalgebra::{Matrix3, Matrix4, Vector3, Vector6};

/// A rigid motion `x -> rotation * x + translation`.
///
/// As `c2w` it maps camera coordinates (OpenCV axes) to world coordinates, as `w2c` the other way.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(bound(serialize = "T: serde::Serialize", deserialize = "T: serde::Deserialize<'de>"))]
pub struct Se3<T: Real> {
    /// Orthonormal, determinant 1.
    pub rotation: Matrix3<T>,
    /// In the units of the target frame.
    pub translation: Vector3<T>,
}

impl<T: Real> Se3<T> {
    /// The motion that moves nothing.
    #[must_use]
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation: Vector3::zeros() }
    }

    /// The upper three rows of a 4x4 matrix, taken as they are.
    #[must_use]
    pub fn from_matrix(m: &Matrix4<T>) -> Self {
        Self { rotation: m.fixed_view::<3, 3>(0, 0).into_owned(), translation: m.fixed_view::<3, 1>(0, 3).into_owned() }
    }

    /// As a 4x4 matrix with last row `0 0 0 1`.
    #[must_use]
    pub fn matrix(&self) -> Matrix4<T> {
        let mut m = Matrix4::identity();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.rotation);
        m.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.translation);
        m
    }

    /// The motion that undoes this one.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// `self` after `first`.
    #[must_use]
    pub fn compose(&self, first: &Self) -> Self {
        Self {
            rotation: self.rotation * first.rotation,
            translation: self.rotation * first.translation + self.translation,
        }
    }

    /// The image of a point.
    #[must_use]
    pub fn transform(&self, x: &Vector3<T>) -> Vector3<T> {
        self.rotation * x + self.translation
    }

    /// Left perturbation `R <- exp([omega]) R`, `T <- exp([omega]) T + tau`, with `twist = (tau, omega)`
    /// (docs/spec/optimiser.md 1.6).
    #[must_use]
    pub fn retract(&self, twist: &Vector6<T>) -> Self {
        let turn = exp_so3(&twist.fixed_rows::<3>(3).into_owned());
        Self {
            rotation: orthonormal(&(turn * self.rotation)),
            translation: turn * self.translation + twist.fixed_rows::<3>(0).into_owned(),
        }
    }
}

/// The cross-product matrix: `hat(a) * b == a x b`.
pub fn hat<T: Real>(a: &Vector3<T>) -> Matrix3<T> {
    let z = T::zero();
    Matrix3::new(z, -a.z, a.y, a.z, z, -a.x, -a.y, a.x, z)
}

/// The rotation by `|omega|` radians about `omega` (Rodrigues).
pub fn exp_so3<T: Real>(omega: &Vector3<T>) -> Matrix3<T> {
    let theta = omega.norm();
    let k = hat(omega);
    if theta < T::of(1e-8) {
        return Matrix3::identity() + k + k * k * T::of(0.5);
    }
    let (a, b) = (theta.sin() / theta, (T::one() - theta.cos()) / (theta * theta));
    Matrix3::identity() + k * a + k * k * b
}

/// The rotation vector of a rotation matrix, of length in `0..=pi` radians.
///
/// By way of the quaternion: the arc cosine of the trace is NaN where rounding puts the trace above 3.
pub fn log_so3<T: Real>(r: &Matrix3<T>) -> Vector3<T> {
    nalgebra::UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(*r)).scaled_axis()
}

/// One Gram-Schmidt step: keeps products of many rotations orthonormal.
fn orthonormal<T: Real>(m: &Matrix3<T>) -> Matrix3<T> {
    let x = m.column(0).normalize();
    let y = m.column(1).into_owned();
    let y = (y - x * x.dot(&y)).normalize();
    Matrix3::from_columns(&[x, y, x.cross(&y)])
}

#[cfg(test)]
mod tests {
    use super::{Se3, exp_so3, log_so3};
    use nalgebra::{Vector3, Vector6};

    #[test]
    fn exp_and_log_are_inverse() {
        for w in [Vector3::new(0.3, -0.2, 0.9), Vector3::new(1e-10, 0.0, 2e-10), Vector3::new(2.0, 1.0, -1.5)] {
            assert!((log_so3(&exp_so3(&w)) - w).norm() < 1e-9, "{w}");
        }
    }

    #[test]
    fn log_of_a_rounded_identity_is_tiny_and_not_nan() {
        for k in 0..200 {
            let r = exp_so3(&Vector3::new(0.01 * f64::from(k), -0.4, 0.3 * f64::from(k).sin()));
            let w = log_so3(&(r.transpose() * r));
            assert!(w.norm() < 1e-12, "{w}");
        }
    }

    #[test]
    fn inverse_undoes_a_motion() {
        let pose = Se3::<f64>::identity().retract(&Vector6::new(0.1, 2.0, -0.4, 0.3, -0.2, 0.9));
        let x = Vector3::new(1.0, -2.0, 3.0);
        assert!((pose.inverse().transform(&pose.transform(&x)) - x).norm() < 1e-12);
        assert!((pose.compose(&pose.inverse()).matrix() - nalgebra::Matrix4::identity()).norm() < 1e-12);
        assert_eq!(Se3::from_matrix(&pose.matrix()), pose);
    }
}
