//! The Lie group side of [`Se3`]: exponential, logarithm, adjoint, and the seven numbers of trajectory files.
//!
//! Twists are `(tau, omega)`, translation first, acting on the left: `exp(xi) * G`. Unlike
//! [`Se3::retract`], whose translation part is added as it is, [`Se3::exp`] is the exponential of the
//! group: `exp(s xi)` for a growing `s` is a screw motion.

use crate::{Real, Se3, exp_so3, hat, log_so3};
use nalgebra::{Matrix3, Matrix6, Quaternion, UnitQuaternion, Vector3, Vector6};

impl<T: Real> Se3<T> {
    /// The motion reached by following the twist `(tau, omega)` for one unit of time.
    #[must_use]
    pub fn exp(twist: &Vector6<T>) -> Self {
        let omega = twist.fixed_rows::<3>(3).into_owned();
        let (theta2, k) = (omega.norm_squared(), hat(&omega));
        let (b, c) = if theta2 < T::of(1e-6) {
            (T::of(0.5) - theta2 / T::of(24.0), T::of(1.0 / 6.0) - theta2 / T::of(120.0))
        } else {
            let theta = theta2.sqrt();
            ((T::one() - theta.cos()) / theta2, (theta - theta.sin()) / (theta2 * theta))
        };
        let v = Matrix3::identity() + k * b + k * k * c;
        Self { rotation: exp_so3(&omega), translation: v * twist.fixed_rows::<3>(0) }
    }

    /// The twist whose [`exp`](Self::exp) this motion is, with a rotation of at most pi radians.
    #[must_use]
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
    #[must_use]
    pub fn adjoint(&self) -> Matrix6<T> {
        let mut ad = Matrix6::zeros();
        ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.rotation);
        ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.rotation);
        ad.fixed_view_mut::<3, 3>(0, 3).copy_from(&(hat(&self.translation) * self.rotation));
        ad
    }

    /// From `tx ty tz qx qy qz qw`; the quaternion is normalised.
    #[must_use]
    pub fn from_translation_quaternion(p: &[T; 7]) -> Self {
        let q = UnitQuaternion::from_quaternion(Quaternion::new(p[6], p[3], p[4], p[5]));
        Self { rotation: q.to_rotation_matrix().into_inner(), translation: Vector3::new(p[0], p[1], p[2]) }
    }

    /// As `tx ty tz qx qy qz qw` with `qw >= 0`.
    #[must_use]
    pub fn to_translation_quaternion(&self) -> [T; 7] {
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(self.rotation);
        let q = UnitQuaternion::from_rotation_matrix(&rotation);
        let (t, s) = (&self.translation, if q.w < T::zero() { -T::one() } else { T::one() });
        [t.x, t.y, t.z, s * q.i, s * q.j, s * q.k, s * q.w]
    }

    /// The same motion with another scalar.
    #[must_use]
    pub fn cast<U: Real>(&self) -> Se3<U> {
        Se3 { rotation: self.rotation.map(|x| U::of(x.f64())), translation: self.translation.map(|x| U::of(x.f64())) }
    }
}

#[cfg(test)]
mod tests {
    use crate::Se3;
    use nalgebra::Vector6;

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
            assert!((a.compose(&b).matrix() - Se3::exp(&xi).matrix()).norm() < 1e-11, "{xi}");
        }
    }

    #[test]
    fn the_adjoint_moves_a_twist_to_the_other_side() {
        let g = Se3::<f64>::exp(&Vector6::new(0.1, 2.0, -0.4, 0.3, -0.2, 0.9));
        let xi = Vector6::new(0.3, -0.1, 0.2, -0.4, 0.5, 0.1);
        let (left, right) = (Se3::exp(&(g.adjoint() * xi)).compose(&g), g.compose(&Se3::exp(&xi)));
        assert!((left.matrix() - right.matrix()).norm() < 1e-12);
    }

    #[test]
    fn seven_numbers_round_trip() {
        let g = Se3::<f64>::exp(&Vector6::new(0.1, 2.0, -0.4, 2.3, -0.2, 0.9));
        let back = Se3::from_translation_quaternion(&g.to_translation_quaternion());
        assert!((back.matrix() - g.matrix()).norm() < 1e-12);
    }
}
