//! Scales, a quaternion and a velocity: a dynamic row of [`Splats`].

use super::{Covariance4, Slice3};
use crate::{Column, ShapeError, Splats};
use crate::{
    Real,
    nalgebra::{Matrix3, Matrix4, Vector3, Vector4},
    quat,
};

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
    /// World units per frame.
    pub velocity: Vector3<T>,
    /// Logit of the opacity at the peak in time.
    pub opacity: T,
    /// Colour coefficients, temporal index major.
    pub colour: Vec<[T; 3]>,
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

    /// Slices the splat at time `t`, frames.
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
