//! The definition of the projection, forward and backward.

use super::{LOW_PASS, jacobian_limits};
use crate::CameraGradient;
use m4_core::{
    Camera, Real, Se3,
    nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3, Vector4},
};

/// A camera in the precision of the reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole<T: Real> {
    /// World to camera.
    pub w2c: Se3<T>,
    /// `fx, fy, cx, cy` in pixels, the principal point from the corner of the image.
    pub intrinsics: Vector4<T>,
    /// `x_min, x_max, y_min, y_max` of [`jacobian_limits`]; constants for the gradient.
    pub limits: [T; 4],
}

impl<T: Real> Pinhole<T> {
    /// `camera`, rounded to `T`.
    pub fn new(camera: &Camera) -> Self {
        let (w2c, k) = (camera.w2c(), &camera.intrinsics);
        Self {
            w2c: Se3 {
                rotation: w2c.rotation.map(T::of),
                translation: w2c.translation.map(T::of),
            },
            intrinsics: Vector4::new(k.fx, k.fy, k.cx, k.cy).map(T::of),
            limits: jacobian_limits(k).map(T::of),
        }
    }

    /// The camera's centre in the world.
    pub fn centre(&self) -> Vector3<T> {
        self.w2c.inverse().translation
    }
}

/// An ellipse on the image; also the gradient with respect to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projected<T: Real> {
    /// Pixels; the centre of the first pixel is at (0, 0).
    pub centre: Vector2<T>,
    /// Inverse covariance, symmetric, 1 / pixels squared.
    pub conic: Matrix2<T>,
    /// z-depth, world units.
    pub depth: T,
    /// Factor of the opacity: below 1 with the Mip filter, exactly 1 without.
    pub compensation: T,
}

/// The gradient of a loss with respect to the input of [`project()`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProjectGradient<T: Real> {
    /// With respect to the 3D mean.
    pub mean: Vector3<T>,
    /// With respect to the 3D covariance, symmetric.
    pub covariance: Matrix3<T>,
    /// With respect to the camera, this splat's share of it.
    pub camera: PinholeGradient<T>,
}

/// The gradient of a loss with respect to a [`Pinhole`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PinholeGradient<T: Real> {
    /// Left twist of the world-to-camera pose, translation part.
    pub tau: Vector3<T>,
    /// Left twist, rotation part.
    pub omega: Vector3<T>,
    /// `fx, fy, cx, cy`.
    pub intrinsics: Vector4<T>,
}

impl<T: Real> PinholeGradient<T> {
    /// No change.
    pub fn zero() -> Self {
        Self {
            tau: Vector3::zeros(),
            omega: Vector3::zeros(),
            intrinsics: Vector4::zeros(),
        }
    }

    /// Adds the share of one more splat.
    pub fn add(&mut self, other: &Self) {
        self.tau += other.tau;
        self.omega += other.omega;
        self.intrinsics += other.intrinsics;
    }

    /// In the precision of the twins.
    pub fn to_camera_gradient(&self) -> CameraGradient {
        CameraGradient {
            tau: self.tau.map(Real::f64).into(),
            omega: self.omega.map(Real::f64).into(),
            intrinsics: self.intrinsics.map(Real::f64).into(),
        }
    }
}

/// What forward and backward share.
struct Footprint<T: Real> {
    point: Vector3<T>,
    /// Where the Jacobian is evaluated: `(kx, ky)`.
    slope: Vector2<T>,
    clamped: [bool; 2],
    jacobian: Matrix2x3<T>,
    camera_covariance: Matrix3<T>,
    /// Without the low pass.
    sharp: Matrix2<T>,
    conic: Matrix2<T>,
    compensation: T,
}

fn inverse<T: Real>(m: &Matrix2<T>) -> Matrix2<T> {
    let det = m.determinant();
    Matrix2::new(m[(1, 1)], -m[(0, 1)], -m[(1, 0)], m[(0, 0)]) / det
}

fn footprint<T: Real>(
    mean: &Vector3<T>,
    covariance: &Matrix3<T>,
    camera: &Pinhole<T>,
    mip: bool,
) -> Footprint<T> {
    let (fx, fy) = (camera.intrinsics[0], camera.intrinsics[1]);
    let point = camera.w2c.transform(mean);
    let z = point.z;
    let [x_min, x_max, y_min, y_max] = camera.limits;
    let ray = Vector2::new(point.x / z, point.y / z);
    // plain comparisons: a NaN stays a NaN and is left out by the caller
    let clamp = |v: T, low: T, high: T| {
        if v < low {
            low
        } else if v > high {
            high
        } else {
            v
        }
    };
    let slope = Vector2::new(clamp(ray.x, x_min, x_max), clamp(ray.y, y_min, y_max));
    let zero = T::zero();
    let jacobian = Matrix2x3::new(
        fx / z,
        zero,
        -fx * slope.x / z,
        zero,
        fy / z,
        -fy * slope.y / z,
    );
    let w = &camera.w2c.rotation;
    let camera_covariance = w * covariance * w.transpose();
    let sharp = jacobian * camera_covariance * jacobian.transpose();
    let blurred = sharp + Matrix2::from_diagonal_element(T::of(LOW_PASS));
    let compensation = if mip {
        // a flat splat seen edge on has determinant 0, give or take rounding
        (sharp.determinant().max(zero) / blurred.determinant()).sqrt()
    } else {
        T::one()
    };
    Footprint {
        point,
        slope,
        clamped: [slope.x != ray.x, slope.y != ray.y],
        jacobian,
        camera_covariance,
        sharp,
        conic: inverse(&blurred),
        compensation,
    }
}

/// The ellipse of a 3D splat; `None` unless its z-depth is above `near`.
pub fn project<T: Real>(
    mean: &Vector3<T>,
    covariance: &Matrix3<T>,
    camera: &Pinhole<T>,
    near: T,
    mip: bool,
) -> Option<Projected<T>> {
    let f = footprint(mean, covariance, camera, mip);
    let [fx, fy, cx, cy] = camera.intrinsics.into();
    let (p, half) = (f.point, T::of(0.5));
    (p.z > near).then(|| Projected {
        centre: Vector2::new(fx * p.x / p.z + cx - half, fy * p.y / p.z + cy - half),
        conic: f.conic,
        depth: p.z,
        compensation: f.compensation,
    })
}

/// Gradient with respect to mean, covariance and camera, given that with respect to [`project()`].
pub fn project_vjp<T: Real>(
    mean: &Vector3<T>,
    covariance: &Matrix3<T>,
    camera: &Pinhole<T>,
    mip: bool,
    g: &Projected<T>,
) -> ProjectGradient<T> {
    let f = footprint(mean, covariance, camera, mip);
    let (fx, fy) = (camera.intrinsics[0], camera.intrinsics[1]);
    let (x, y, z) = (f.point.x, f.point.y, f.point.z);
    let (two, zz) = (T::of(2.0), z * z);

    let mut d_sharp = -(f.conic * g.conic * f.conic);
    // where the determinant is 0 the root has no derivative: the compensation passes none
    if mip && f.compensation > T::zero() {
        d_sharp += (inverse(&f.sharp) - f.conic) * (T::of(0.5) * f.compensation * g.compensation);
    }
    let j = &f.jacobian;
    let d_camera_covariance = j.transpose() * d_sharp * j;
    let d_j = d_sharp * j * f.camera_covariance * two;

    let mut d_point = Vector3::new(
        g.centre.x * fx / z,
        g.centre.y * fy / z,
        g.depth
            - (g.centre.x * fx * x + g.centre.y * fy * y) / zz
            - d_j[(0, 0)] * fx / zz
            - d_j[(1, 1)] * fy / zz,
    );
    for (axis, focal) in [(0, fx), (1, fy)] {
        let d = d_j[(axis, 2)] * focal / zz;
        if f.clamped[axis] {
            d_point.z += d * f.slope[axis];
        } else {
            d_point[axis] -= d;
            d_point.z += two * d * f.point[axis] / z;
        }
    }

    let w = &camera.w2c.rotation;
    let k = d_camera_covariance * f.camera_covariance * two;
    let axial = Vector3::new(
        k[(2, 1)] - k[(1, 2)],
        k[(0, 2)] - k[(2, 0)],
        k[(1, 0)] - k[(0, 1)],
    );
    ProjectGradient {
        mean: w.transpose() * d_point,
        covariance: w.transpose() * d_camera_covariance * w,
        camera: PinholeGradient {
            tau: d_point,
            omega: f.point.cross(&d_point) + axial,
            intrinsics: Vector4::new(
                g.centre.x * x / z + d_j[(0, 0)] / z - d_j[(0, 2)] * f.slope.x / z,
                g.centre.y * y / z + d_j[(1, 1)] / z - d_j[(1, 2)] * f.slope.y / z,
                g.centre.x,
                g.centre.y,
            ),
        },
    }
}
