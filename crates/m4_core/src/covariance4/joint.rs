//! One covariance over space and time.

use super::VelocityForm;
use crate::{
    Real,
    nalgebra::{Matrix3, Matrix4, Rotation3, UnitQuaternion, Vector3, Vector4},
    rotor,
};

/// Rows and columns of the ten packed entries: the upper triangle, row by row.
const PACKED: [(usize, usize); 10] = [
    (0, 0),
    (0, 1),
    (0, 2),
    (0, 3),
    (1, 1),
    (1, 2),
    (1, 3),
    (2, 2),
    (2, 3),
    (3, 3),
];

/// A dynamic splat with one covariance over space and time.
#[derive(Debug, Clone, PartialEq)]
pub struct Covariance4<T: Real> {
    /// x, y, z in world units, t in frames.
    pub mean: [T; 4],
    /// `xx, xy, xz, xt, yy, yz, yt, zz, zt, tt`; positive definite.
    pub covariance: [T; 10],
    /// Logit of the opacity at the peak in time.
    pub opacity: T,
    /// Colour coefficients, temporal index major, as in [`crate::Column::Colour`].
    pub colour: Vec<[T; 3]>,
}

/// The slice of a splat at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slice3<T: Real> {
    /// Conditional mean, world units.
    pub mean: Vector3<T>,
    /// Conditional covariance, world units squared.
    pub covariance: Matrix3<T>,
    /// Temporal marginal with peak 1.
    pub marginal: T,
}

/// Why a 4x4 covariance is not that of a splat.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Covariance4Error {
    /// The variance in time is not a positive number.
    #[error("the variance in time is {variance}; it must be above 0 (a static splat has no 4D form)")]
    Time {
        /// The value in the file.
        variance: f64,
    },
    /// The slice at an instant has a direction without extent.
    #[error("the covariance at an instant has the eigenvalue {eigenvalue}; it must be above 0 in every direction")]
    Space {
        /// The smallest one.
        eigenvalue: f64,
    },
}

impl<T: Real> Covariance4<T> {
    /// Takes the upper triangle of `covariance`, order x, y, z, t.
    #[must_use]
    pub fn from_matrix(mean: [T; 4], covariance: &Matrix4<T>, opacity: T, colour: Vec<[T; 3]>) -> Self {
        Self {
            mean,
            covariance: PACKED.map(|at| covariance[at]),
            opacity,
            colour,
        }
    }

    /// From the rotor pair: `R(left, right) diag(exp(2 log_scale)) R^T` (docs/spec/optimiser.md 1.2).
    /// `log_scale` is that of the unrotated x, y, z and t axes.
    #[must_use]
    pub fn from_rotor(
        mean: [T; 4],
        log_scale: &Vector4<T>,
        left: &Vector4<T>,
        right: &Vector4<T>,
        opacity: T,
        colour: Vec<[T; 3]>,
    ) -> Self {
        let axes = rotor::rotation(left, right) * Matrix4::from_diagonal(&log_scale.map(|s| s.exp()));
        Self::from_matrix(mean, &(axes * axes.transpose()), opacity, colour)
    }

    /// The symmetric matrix, order x, y, z, t.
    #[must_use]
    pub fn matrix(&self) -> Matrix4<T> {
        let mut m = Matrix4::zeros();
        for (&(i, j), &value) in PACKED.iter().zip(&self.covariance) {
            m[(i, j)] = value;
            m[(j, i)] = value;
        }
        m
    }

    /// `(S, v, w)`: covariance at an instant, velocity, variance in time.
    fn conditional(&self) -> (Matrix3<T>, Vector3<T>, T) {
        let m = self.matrix();
        let w = m[(3, 3)];
        let cross = m.fixed_view::<3, 1>(0, 3).into_owned();
        let space = m.fixed_view::<3, 3>(0, 0) - cross * cross.transpose() / w;
        (space, cross / w, w)
    }

    /// Slices the splat at time `t`, frames.
    #[must_use]
    pub fn slice(&self, t: T) -> Slice3<T> {
        let (covariance, velocity, w) = self.conditional();
        let dt = t - self.mean[3];
        Slice3 {
            mean: Vector3::new(self.mean[0], self.mean[1], self.mean[2]) + velocity * dt,
            covariance,
            marginal: (T::of(-0.5) * dt * dt / w).exp(),
        }
    }

    /// The same splat with scales, a quaternion and a velocity. The order of the axes is not unique;
    /// every choice is the same splat.
    ///
    /// # Errors
    ///
    /// [`Covariance4Error`] if the covariance is not positive definite.
    pub fn to_velocity(&self) -> Result<VelocityForm<T>, Covariance4Error> {
        let (space, velocity, w) = self.conditional();
        if w <= T::zero() || !w.is_finite() {
            return Err(Covariance4Error::Time { variance: w.f64() });
        }
        if !space.iter().all(|v| v.is_finite()) {
            return Err(Covariance4Error::Space { eigenvalue: f64::NAN });
        }
        let none = Covariance4Error::Space { eigenvalue: f64::NAN };
        let eigen = space.try_symmetric_eigen(T::default_epsilon(), 256).ok_or(none)?;
        let smallest = eigen.eigenvalues.min();
        if smallest <= T::zero() || !smallest.is_finite() {
            return Err(Covariance4Error::Space {
                eigenvalue: smallest.f64(),
            });
        }
        let mut axes = eigen.eigenvectors;
        if axes.determinant() < T::zero() {
            axes.column_mut(0).neg_mut();
        }
        let unit = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let half = T::of(0.5);
        Ok(VelocityForm {
            mean: Vector3::new(self.mean[0], self.mean[1], self.mean[2]),
            log_scale: eigen.eigenvalues.map(|v| half * v.ln()),
            quat: Vector4::new(unit.w, unit.i, unit.j, unit.k),
            time_mean: self.mean[3],
            log_time_sd: half * w.ln(),
            velocity,
            opacity: self.opacity,
            colour: self.colour.clone(),
        })
    }
}
