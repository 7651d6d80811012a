//! Rigid motions with a left retraction; their Lie group: exponential, logarithm, adjoint, and the
//! seven numbers of trajectory files.
//!
//! Twists are `(tau, omega)`, translation first, acting on the left: `exp(xi) * G`. Unlike
//! [`Se3::retract`], whose translation part is added as it is, [`Se3::exp`] is the exponential of
//! the group, a screw motion.

use crate::Real;
use nalgebra::{Matrix3, Matrix4, Matrix6, Quaternion, UnitQuaternion, Vector3, Vector6};

/// A rigid motion `x -> rotation * x + translation`.
///
/// As `c2w` it maps camera coordinates (OpenCV axes) to world coordinates, as `w2c` the other way.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(bound(
    serialize = "T: serde::Serialize",
    deserialize = "T: serde::Deserialize<'de>"
))]
pub struct Se3<T: Real> {
    /// Orthonormal, determinant 1.
    pub rotation: Matrix3<T>,
    /// In the units of the target frame.
    pub translation: Vector3<T>,
}

impl<T: Real> Se3<T> {
    /// The motion that moves nothing.
    pub fn identity() -> Self {
        Self {
            rotation: Matrix3::identity(),
            translation: Vector3::zeros(),
        }
    }

    /// The upper three rows of a 4x4 matrix, taken as they are.
    pub fn from_matrix(m: &Matrix4<T>) -> Self {
        Self {
            rotation: m.fixed_view::<3, 3>(0, 0).into_owned(),
            translation: m.fixed_view::<3, 1>(0, 3).into_owned(),
        }
    }

    /// As a 4x4 matrix with last row `0 0 0 1`.
    pub fn matrix(&self) -> Matrix4<T> {
        let mut m = Matrix4::identity();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.rotation);
        m.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.translation);
        m
    }

    /// The motion that undoes this one.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }

    /// `self` after `first`.
    pub fn compose(&self, first: &Self) -> Self {
        Self {
            rotation: self.rotation * first.rotation,
            translation: self.rotation * first.translation + self.translation,
        }
    }

    /// The image of a point.
    pub fn transform(&self, x: &Vector3<T>) -> Vector3<T> {
        self.rotation * x + self.translation
    }

    /// Left perturbation `R <- exp([omega]) R`, `T <- exp([omega]) T + tau`, with
    /// `twist = (tau, omega)` (docs/spec/optimiser.md 1.6).
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
    let (a, b) = (
        theta.sin() / theta,
        (T::one() - theta.cos()) / (theta * theta),
    );
    Matrix3::identity() + k * a + k * k * b
}

/// The rotation vector of a rotation matrix, of length in `0..=pi` radians.
///
/// By way of the quaternion: the arc cosine of the trace is NaN where rounding puts the trace above
/// 3.
pub fn log_so3<T: Real>(r: &Matrix3<T>) -> Vector3<T> {
    UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(*r))
        .scaled_axis()
}

/// One Gram-Schmidt step: keeps products of many rotations orthonormal.
fn orthonormal<T: Real>(m: &Matrix3<T>) -> Matrix3<T> {
    let x = m.column(0).normalize();
    let y = m.column(1).into_owned();
    let y = (y - x * x.dot(&y)).normalize();
    Matrix3::from_columns(&[x, y, x.cross(&y)])
}

impl<T: Real> Se3<T> {
    /// The motion reached by following the twist `(tau, omega)` for one unit of time.
    pub fn exp(twist: &Vector6<T>) -> Self {
        let omega = twist.fixed_rows::<3>(3).into_owned();
        let (theta2, k) = (omega.norm_squared(), hat(&omega));
        let (b, c) = if theta2 < T::of(1e-6) {
            (
                T::of(0.5) - theta2 / T::of(24.0),
                T::of(1.0 / 6.0) - theta2 / T::of(120.0),
            )
        } else {
            let theta = theta2.sqrt();
            (
                (T::one() - theta.cos()) / theta2,
                (theta - theta.sin()) / (theta2 * theta),
            )
        };
        let v = Matrix3::identity() + k * b + k * k * c;
        Self {
            rotation: exp_so3(&omega),
            translation: v * twist.fixed_rows::<3>(0),
        }
    }

    /// The twist whose [`exp`](Self::exp) this motion is, with a rotation of at most pi radians.
    pub fn log(&self) -> Vector6<T> {
        let omega = log_so3(&self.rotation);
        let (theta2, k) = (omega.norm_squared(), hat(&omega));
        let c = if theta2 < T::of(1e-6) {
            T::of(1.0 / 12.0) + theta2 / T::of(720.0)
        } else {
            let theta = theta2.sqrt();
            // (1 + cos) / sin of the angle is the cotangent of its half, finite up to pi.
            let half = theta * T::of(0.5);
            (T::one() - half * half.cos() / half.sin()) / theta2
        };
        let tau = (Matrix3::identity() - k * T::of(0.5) + k * k * c) * self.translation;
        Vector6::new(tau.x, tau.y, tau.z, omega.x, omega.y, omega.z)
    }

    /// `Ad` with `G exp(xi) = exp(Ad xi) G`.
    pub fn adjoint(&self) -> Matrix6<T> {
        let mut ad = Matrix6::zeros();
        ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.rotation);
        ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.rotation);
        ad.fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&(hat(&self.translation) * self.rotation));
        ad
    }

    /// From `tx ty tz qx qy qz qw`; the quaternion is normalised.
    pub fn from_translation_quaternion(p: &[T; 7]) -> Self {
        let q = UnitQuaternion::from_quaternion(Quaternion::new(p[6], p[3], p[4], p[5]));
        Self {
            rotation: q.to_rotation_matrix().into_inner(),
            translation: Vector3::new(p[0], p[1], p[2]),
        }
    }

    /// As `tx ty tz qx qy qz qw` with `qw >= 0`.
    pub fn to_translation_quaternion(&self) -> [T; 7] {
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(self.rotation);
        let q = UnitQuaternion::from_rotation_matrix(&rotation);
        let (t, s) = (
            &self.translation,
            if q.w < T::zero() { -T::one() } else { T::one() },
        );
        [t.x, t.y, t.z, s * q.i, s * q.j, s * q.k, s * q.w]
    }

    /// The same motion with another scalar.
    pub fn cast<U: Real>(&self) -> Se3<U> {
        Se3 {
            rotation: self.rotation.map(|x| U::of(x.f64())),
            translation: self.translation.map(|x| U::of(x.f64())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Se3, exp_so3, log_so3};
    use nalgebra::{Vector3, Vector6};

    #[test]
    fn exp_and_log_are_inverse() {
        for w in [
            Vector3::new(0.3, -0.2, 0.9),
            Vector3::new(1e-10, 0.0, 2e-10),
            Vector3::new(2.0, 1.0, -1.5),
        ] {
            assert!((log_so3(&exp_so3(&w)) - w).norm() < 1e-9, "{w}");
        }
    }

    #[test]
    fn log_of_a_rounded_identity_is_tiny_and_not_nan() {
        for k in 0..200 {
            let r = exp_so3(&Vector3::new(
                0.01 * f64::from(k),
                -0.4,
                0.3 * f64::from(k).sin(),
            ));
            let w = log_so3(&(r.transpose() * r));
            assert!(w.norm() < 1e-12, "{w}");
        }
    }

    #[test]
    fn inverse_undoes_a_motion() {
        let pose = Se3::<f64>::identity().retract(&Vector6::new(0.1, 2.0, -0.4, 0.3, -0.2, 0.9));
        let x = Vector3::new(1.0, -2.0, 3.0);
        assert!((pose.inverse().transform(&pose.transform(&x)) - x).norm() < 1e-12);
        assert!(
            (pose.compose(&pose.inverse()).matrix() - nalgebra::Matrix4::identity()).norm() < 1e-12
        );
        assert_eq!(Se3::from_matrix(&pose.matrix()), pose);
    }

    #[test]
    fn exp_and_log_are_inverse_and_exp_is_a_one_parameter_group() {
        for xi in [
            Vector6::new(0.1, 2.0, -0.4, 0.3, -0.2, 0.9),
            Vector6::new(1.0, -2.0, 3.0, 1e-5, 2e-4, -1e-4),
            Vector6::new(1.0, -2.0, 3.0, 0.0, 0.0, 0.0),
            Vector6::new(-0.3, 0.2, 0.1, 2.0, 1.0, -1.5),
        ] {
            assert!((Se3::exp(&xi).log() - xi).norm() < 1e-9, "{xi}");
            let (a, b) = (Se3::exp(&(xi * 0.3)), Se3::exp(&(xi * 0.7)));
            assert!(
                (a.compose(&b).matrix() - Se3::exp(&xi).matrix()).norm() < 1e-11,
                "{xi}"
            );
        }
    }

    #[test]
    fn the_adjoint_moves_a_twist_to_the_other_side() {
        let g = Se3::<f64>::exp(&Vector6::new(0.1, 2.0, -0.4, 0.3, -0.2, 0.9));
        let xi = Vector6::new(0.3, -0.1, 0.2, -0.4, 0.5, 0.1);
        let (left, right) = (
            Se3::exp(&(g.adjoint() * xi)).compose(&g),
            g.compose(&Se3::exp(&xi)),
        );
        assert!((left.matrix() - right.matrix()).norm() < 1e-12);
    }

    #[test]
    fn seven_numbers_round_trip() {
        let g = Se3::<f64>::exp(&Vector6::new(0.1, 2.0, -0.4, 2.3, -0.2, 0.9));
        let back = Se3::from_translation_quaternion(&g.to_translation_quaternion());
        assert!((back.matrix() - g.matrix()).norm() < 1e-12);
    }
}
