//! Dynamic splats as 4D Gaussians with one 4x4 covariance, and the exact way to and from the columns
//! of [`Splats`] (sections 1.2 to 1.4 of the optimiser's specification).
//!
//! The two forms are the same model. With `S` the covariance that an instant sees, `v` the velocity
//! and `w` the variance in time:
//!
//! ```text
//! covariance = [[S + w v v^T, w v], [w v^T, w]]        order x, y, z, t
//! w = covariance[t][t],  v = covariance[xyz][t] / w,  S = covariance[xyz][xyz] - w v v^T
//! ```
//!
//! Files of other programs hold this form, or the rotor pair from which [`Covariance4::from_rotor`]
//! builds it.

use crate::{Column, ShapeError, Splats};
use m4_math::{
    Real,
    nalgebra::{Matrix3, Matrix4, Rotation3, UnitQuaternion, Vector3, Vector4},
    quat, rotor,
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
    /// Colour coefficients, temporal index major, as in [`Column::Colour`].
    pub colour: Vec<[T; 3]>,
}

/// The same splat as the columns of [`Splats`] hold it.
#[derive(Debug, Clone, PartialEq)]
pub struct VelocityForm<T: Real> {
    /// At `time_mean`, world units.
    pub mean: Vector3<T>,
    /// Natural logarithms of the standard deviations that an instant sees, world units.
    pub log_scale: Vector3<T>,
    /// `(w, x, y, z)` of any length but 0.
    pub quat: Vector4<T>,
    /// Frames.
    pub time_mean: T,
    /// Natural logarithm of the standard deviation in time, frames.
    pub log_time_sd: T,
    /// World units a frame.
    pub velocity: Vector3<T>,
    /// Logit of the opacity at the peak in time.
    pub opacity: T,
    /// Colour coefficients, temporal index major.
    pub colour: Vec<[T; 3]>,
}

/// What an instant sees of a splat.
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
        /// As found.
        variance: f64,
    },
    /// What an instant sees has a direction without extent.
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

    /// From the rotor pair: `R(left, right) diag(exp(2 log_scale)) R^T` (section 1.2). `log_scale` is
    /// that of the unrotated x, y, z and t axes.
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

    /// What time `t`, frames, sees.
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

impl<T: Real> VelocityForm<T> {
    /// The same splat with one covariance over space and time.
    #[must_use]
    pub fn to_covariance4(&self) -> Covariance4<T> {
        let w = (T::of(2.0) * self.log_time_sd).exp();
        let cross = self.velocity * w;
        let mut m = Matrix4::zeros();
        let space = self.space() + self.velocity * cross.transpose();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&space);
        m.fixed_view_mut::<3, 1>(0, 3).copy_from(&cross);
        m[(3, 3)] = w;
        let mean = [self.mean.x, self.mean.y, self.mean.z, self.time_mean];
        Covariance4::from_matrix(mean, &m, self.opacity, self.colour.clone())
    }

    fn space(&self) -> Matrix3<T> {
        let axes = quat::rotation(&self.quat) * Matrix3::from_diagonal(&self.log_scale.map(|s| s.exp()));
        axes * axes.transpose()
    }

    /// What time `t`, frames, sees.
    #[must_use]
    pub fn slice(&self, t: T) -> Slice3<T> {
        let dt = t - self.time_mean;
        let w = (T::of(2.0) * self.log_time_sd).exp();
        Slice3 {
            mean: self.mean + self.velocity * dt,
            covariance: self.space(),
            marginal: (T::of(-0.5) * dt * dt / w).exp(),
        }
    }

    /// Dynamic splat `index` of `splats`; an isotropic one gets three equal scales.
    ///
    /// # Errors
    ///
    /// [`ShapeError`] if there is no such splat.
    pub fn from_splats(splats: &Splats, index: usize) -> Result<Self, ShapeError> {
        check_index(splats, index)?;
        let layout = splats.layout();
        let row = splats.n_static() + index;
        let at = |column, offset, row: usize| T::of(f64::from(splats.column(column, offset)[row]));
        Ok(Self {
            mean: Vector3::from_fn(|k, _| at(Column::Mean, k, row)),
            log_scale: Vector3::from_fn(|k, _| at(Column::LogScale, if layout.isotropic { 0 } else { k }, row)),
            quat: if layout.isotropic {
                Vector4::new(T::one(), T::zero(), T::zero(), T::zero())
            } else {
                Vector4::from_fn(|k, _| at(Column::Quat, k, row))
            },
            time_mean: at(Column::TimeMean, 0, index),
            log_time_sd: at(Column::LogTimeSd, 0, index),
            velocity: Vector3::from_fn(|k, _| at(Column::Velocity, k, index)),
            opacity: at(Column::Opacity, 0, row),
            colour: (0..layout.colour_terms())
                .map(|term| std::array::from_fn(|c| at(Column::Colour, 3 * term + c, row)))
                .collect(),
        })
    }

    /// Writes this splat, rounded to f32, to dynamic splat `index` of `splats`.
    ///
    /// # Errors
    ///
    /// [`ShapeError`] if there is no such splat, the colour has another number of coefficients, or
    /// `splats` are isotropic (they have no room for a quaternion).
    pub fn write(&self, splats: &mut Splats, index: usize) -> Result<(), ShapeError> {
        check_index(splats, index)?;
        let layout = splats.layout();
        ShapeError::check("colour terms", layout.colour_terms(), self.colour.len())?;
        ShapeError::check("quaternion columns", 4, layout.range(Column::Quat).len())?;
        let row = splats.n_static() + index;
        let mut set = |column, offset, row: usize, value: T| {
            splats.column_mut(column, offset)[row] = value.f64() as f32;
        };
        for k in 0..3 {
            set(Column::Mean, k, row, self.mean[k]);
            set(Column::LogScale, k, row, self.log_scale[k]);
            set(Column::Velocity, k, index, self.velocity[k]);
        }
        for k in 0..4 {
            set(Column::Quat, k, row, self.quat[k]);
        }
        set(Column::Opacity, 0, row, self.opacity);
        set(Column::TimeMean, 0, index, self.time_mean);
        set(Column::LogTimeSd, 0, index, self.log_time_sd);
        for (k, &value) in self.colour.as_flattened().iter().enumerate() {
            set(Column::Colour, k, row, value);
        }
        Ok(())
    }
}

fn check_index(splats: &Splats, index: usize) -> Result<(), ShapeError> {
    if index < splats.n_dynamic() {
        return Ok(());
    }
    Err(ShapeError {
        what: "dynamic splat",
        expected: splats.n_dynamic(),
        found: index,
    })
}

#[cfg(test)]
mod tests {
    use super::{Covariance4, Covariance4Error, Slice3, VelocityForm};
    use crate::{SplatLayout, Splats};
    use m4_math::{
        CounterRng,
        nalgebra::{Matrix4, Vector3, Vector4},
    };

    fn rotor(index: u64) -> Covariance4<f64> {
        let mut rng = CounterRng::new(1, 0, index);
        let mean = std::array::from_fn(|_| rng.normal());
        let log_scale = Vector4::from_fn(|_, _| -2.0 * rng.uniform());
        let left = Vector4::from_fn(|_, _| rng.normal());
        let right = Vector4::from_fn(|_, _| rng.normal());
        Covariance4::from_rotor(mean, &log_scale, &left, &right, rng.normal(), vec![[0.1, 0.2, 0.3]])
    }

    fn assert_slices(a: &Slice3<f64>, b: &Slice3<f64>) {
        assert!((a.mean - b.mean).norm() < 1e-12 * (1.0 + a.mean.norm()), "{a:?} {b:?}");
        assert!((a.covariance - b.covariance).norm() < 1e-12, "{a:?} {b:?}");
        assert!((a.marginal - b.marginal).abs() < 1e-12, "{a:?} {b:?}");
    }

    #[test]
    fn both_forms_are_one_model() {
        for index in 0..500 {
            let form = rotor(index);
            let velocity = form.to_velocity().unwrap();
            let back = velocity.to_covariance4();
            assert!((back.matrix() - form.matrix()).norm() < 1e-12, "{form:?}");
            assert_eq!(
                (back.mean, back.opacity, &back.colour),
                (form.mean, form.opacity, &form.colour)
            );
            for t in [-2.0, -0.3, 0.0, 0.5, 1.7] {
                let t = form.mean[3] + t;
                assert_slices(&form.slice(t), &velocity.slice(t));
            }
        }
    }

    #[test]
    fn a_slice_is_the_conditional_of_the_joint_density() {
        let form = rotor(7);
        let precision = form.matrix().try_inverse().unwrap();
        let seen = form.slice(form.mean[3] + 0.4);
        let x = seen.mean + Vector3::new(0.1, -0.05, 0.02);
        let d = Vector4::new(x.x - form.mean[0], x.y - form.mean[1], x.z - form.mean[2], 0.4);
        let joint = d.dot(&(precision * d));
        let inverse = seen.covariance.try_inverse().unwrap();
        let conditional = (x - seen.mean).dot(&(inverse * (x - seen.mean)));
        assert!((joint - conditional + 2.0 * seen.marginal.ln()).abs() < 1e-9 * joint);
    }

    #[test]
    fn equal_rotors_stand_still() {
        let q = Vector4::new(0.3, -0.4, 0.5, 0.6);
        let log_scale = Vector4::<f64>::new(-1.0, -0.5, -2.0, 0.7);
        let form = Covariance4::from_rotor([0.0; 4], &log_scale, &q, &q, 0.0, Vec::new());
        let velocity = form.to_velocity().unwrap();
        assert!(velocity.velocity.norm() < 1e-14 && (velocity.log_time_sd - 0.7).abs() < 1e-14);
    }

    #[test]
    fn splats_keep_the_form() {
        let layout = SplatLayout {
            isotropic: false,
            sh_degree: 0,
            time_degree: 0,
        };
        let mut splats = Splats::zeros(layout, 3, 2);
        let form = rotor(3).to_velocity().unwrap();
        form.write(&mut splats, 1).unwrap();
        let read = VelocityForm::<f64>::from_splats(&splats, 1).unwrap();
        let (a, b) = (read.to_covariance4().matrix(), form.to_covariance4().matrix());
        assert!((a - b).norm() < 1e-6 * b.norm());
        assert!(form.write(&mut splats, 2).is_err() && VelocityForm::<f64>::from_splats(&splats, 2).is_err());
        let mut isotropic = Splats::zeros(
            SplatLayout {
                isotropic: true,
                ..layout
            },
            0,
            1,
        );
        assert!(form.write(&mut isotropic, 0).is_err());
        assert_eq!(VelocityForm::<f64>::from_splats(&isotropic, 0).unwrap().quat.x, 1.0);
    }

    #[test]
    fn what_is_no_splat_is_an_error() {
        let mut m = Matrix4::<f64>::identity();
        m[(3, 3)] = 0.0;
        let error = |m: &Matrix4<f64>| {
            Covariance4::from_matrix([0.0; 4], m, 0.0, Vec::new())
                .to_velocity()
                .unwrap_err()
        };
        assert!(matches!(error(&m), Covariance4Error::Time { .. }));
        m[(3, 3)] = f64::NAN;
        assert!(matches!(error(&m), Covariance4Error::Time { .. }));
        m[(3, 3)] = 1.0;
        m[(1, 1)] = -1.0;
        assert!(matches!(error(&m), Covariance4Error::Space { .. }));
        m[(1, 1)] = f64::NAN;
        assert!(matches!(error(&m), Covariance4Error::Space { .. }));
    }
}
