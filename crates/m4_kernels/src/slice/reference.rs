//! The definition of slicing, forward and backward.
//!
//! Three models (docs/spec/optimiser.md 1.2 to 1.5): the velocity form with three scales and a
//! quaternion, the same with one scale, and the rotor pair. A gradient has the type of what it is
//! the gradient of.

use m4_core::{
    Real,
    nalgebra::{Matrix3, Matrix4, Vector3, Vector4},
    quat, rotor,
};

/// Size and orientation in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape<T: Real> {
    /// The same standard deviation in every direction.
    Isotropic {
        /// Natural logarithm of the standard deviation, world units.
        log_scale: T,
    },
    /// Three standard deviations along the axes of a rotated frame.
    Anisotropic {
        /// Natural logarithms of the standard deviations, world units.
        log_scale: Vector3<T>,
        /// `(w, x, y, z)` of any length but 0.
        quat: Vector4<T>,
    },
}

/// Life and motion of a dynamic splat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Life<T: Real> {
    /// The middle of its life, frames.
    pub time_mean: T,
    /// Natural logarithm of the standard deviation in time, frames.
    pub log_time_sd: T,
    /// World units per frame.
    pub velocity: Vector3<T>,
}

/// The velocity form (docs/spec/optimiser.md 1.4); static without a `life`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gaussian<T: Real> {
    /// World units; of a dynamic splat: at `time_mean`.
    pub mean: Vector3<T>,
    /// Size and orientation.
    pub shape: Shape<T>,
    /// Absent for static splats.
    pub life: Option<Life<T>>,
}

/// The rotor-pair form (docs/spec/optimiser.md 1.1 to 1.3).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RotorGaussian<T: Real> {
    /// World units, at `time_mean`.
    pub mean: Vector3<T>,
    /// Frames.
    pub time_mean: T,
    /// Natural logarithms of the standard deviations along the *unrotated* x, y, z and t axes.
    pub log_scale: Vector4<T>,
    /// Left rotor `(w, x, y, z)`, any length but 0.
    pub left: Vector4<T>,
    /// Right rotor `(w, x, y, z)`, any length but 0.
    pub right: Vector4<T>,
}

/// A 3D splat: what one instant sees; also the gradient with respect to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sliced<T: Real> {
    /// World units.
    pub mean: Vector3<T>,
    /// Symmetric, world units squared.
    pub covariance: Matrix3<T>,
    /// Temporal marginal with peak 1; exactly 1 for static splats.
    pub marginal: T,
}

fn scaled_axes<T: Real>(log_scale: &Vector3<T>, quat: &Vector4<T>) -> Matrix3<T> {
    quat::rotation(quat) * Matrix3::from_diagonal(&log_scale.map(|s| s.exp()))
}

/// The 3D splat at time `t`, frames: mean, covariance and marginal with peak 1 (Minute4D Eq. 1).
pub fn slice<T: Real>(splat: &Gaussian<T>, t: T) -> Sliced<T> {
    let covariance = match &splat.shape {
        Shape::Isotropic { log_scale } => {
            Matrix3::from_diagonal_element((T::of(2.0) * *log_scale).exp())
        }
        Shape::Anisotropic { log_scale, quat } => {
            let axes = scaled_axes(log_scale, quat);
            axes * axes.transpose()
        }
    };
    let (mean, marginal) = match &splat.life {
        None => (splat.mean, T::one()),
        Some(life) => {
            let dt = t - life.time_mean;
            let variance = (T::of(2.0) * life.log_time_sd).exp();
            (
                splat.mean + life.velocity * dt,
                (T::of(-0.5) * dt * dt / variance).exp(),
            )
        }
    };
    Sliced {
        mean,
        covariance,
        marginal,
    }
}

/// Gradient with respect to the splat, given that with respect to [`slice()`] of it.
pub fn slice_vjp<T: Real>(splat: &Gaussian<T>, t: T, g: &Sliced<T>) -> Gaussian<T> {
    let two = T::of(2.0);
    let shape = match &splat.shape {
        Shape::Isotropic { log_scale } => Shape::Isotropic {
            log_scale: two * (two * *log_scale).exp() * g.covariance.trace(),
        },
        Shape::Anisotropic { log_scale, quat } => {
            let axes = scaled_axes(log_scale, quat);
            let d_axes = g.covariance * axes * two;
            let scale = Matrix3::from_diagonal(&log_scale.map(|s| s.exp()));
            Shape::Anisotropic {
                log_scale: Vector3::from_fn(|k, _| d_axes.column(k).dot(&axes.column(k))),
                quat: quat::rotation_vjp(quat, &(d_axes * scale)),
            }
        }
    };
    let life = splat.life.as_ref().map(|life| {
        let dt = t - life.time_mean;
        let variance = (two * life.log_time_sd).exp();
        let d_log = g.marginal * (T::of(-0.5) * dt * dt / variance).exp();
        Life {
            time_mean: -g.mean.dot(&life.velocity) + d_log * dt / variance,
            log_time_sd: d_log * dt * dt / variance,
            velocity: g.mean * dt,
        }
    });
    Gaussian {
        mean: g.mean,
        shape,
        life,
    }
}

/// The 4x4 covariance of a rotor-pair splat and its factor `R diag(s)`, storage order
/// `(x, y, z, t)`.
fn rotor_covariance<T: Real>(splat: &RotorGaussian<T>) -> (Matrix4<T>, Matrix4<T>) {
    let scale = Matrix4::from_diagonal(&splat.log_scale.map(|s| s.exp()));
    let axes = rotor::rotation(&splat.left, &splat.right) * scale;
    (axes * axes.transpose(), axes)
}

/// Blocks `U` (3x3), `u` (3) and `w` of `[[U, u], [u^T, w]]`.
fn blocks<T: Real>(m: &Matrix4<T>) -> (Matrix3<T>, Vector3<T>, T) {
    (
        m.fixed_view::<3, 3>(0, 0).into_owned(),
        m.fixed_view::<3, 1>(0, 3).into_owned(),
        m[(3, 3)],
    )
}

/// The same of the rotor-pair form.
pub fn slice_rotor<T: Real>(splat: &RotorGaussian<T>, t: T) -> Sliced<T> {
    let (space, cross, variance) = blocks(&rotor_covariance(splat).0);
    let dt = t - splat.time_mean;
    Sliced {
        mean: splat.mean + cross * (dt / variance),
        covariance: space - cross * cross.transpose() / variance,
        marginal: (T::of(-0.5) * dt * dt / variance).exp(),
    }
}

/// Gradient with respect to the splat, given that with respect to [`slice_rotor`] of it.
pub fn slice_rotor_vjp<T: Real>(splat: &RotorGaussian<T>, t: T, g: &Sliced<T>) -> RotorGaussian<T> {
    let two = T::of(2.0);
    let (covariance, axes) = rotor_covariance(splat);
    let (_, cross, w) = blocks(&covariance);
    let dt = t - splat.time_mean;
    let d_log = g.marginal * (T::of(-0.5) * dt * dt / w).exp();

    let d_cross = g.covariance * cross * (-two / w) + g.mean * (dt / w);
    let d_w = cross.dot(&(g.covariance * cross)) / (w * w) - g.mean.dot(&cross) * dt / (w * w)
        + d_log * dt * dt / (two * w * w);
    let mut d_covariance = Matrix4::zeros();
    d_covariance
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&g.covariance);
    d_covariance
        .fixed_view_mut::<3, 1>(0, 3)
        .copy_from(&(d_cross / two));
    d_covariance
        .fixed_view_mut::<1, 3>(3, 0)
        .copy_from(&(d_cross / two).transpose());
    d_covariance[(3, 3)] = d_w;

    let d_axes = d_covariance * axes * two;
    let scale = Matrix4::from_diagonal(&splat.log_scale.map(|s| s.exp()));
    let (left, right) = rotor::rotation_vjp(&splat.left, &splat.right, &(d_axes * scale));
    RotorGaussian {
        mean: g.mean,
        time_mean: -g.mean.dot(&cross) / w + d_log * dt / w,
        log_scale: Vector4::from_fn(|k, _| d_axes.column(k).dot(&axes.column(k))),
        left,
        right,
    }
}
