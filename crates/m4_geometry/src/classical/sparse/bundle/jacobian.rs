//! Residuals and their derivatives.

use m4_core::{
    Se3, hat,
    nalgebra::{Matrix2x3, Matrix2x6, Vector2, Vector3},
};

/// The residual of a point, pixels; `None` when the point is not in front of the camera.
pub(crate) fn project(w2c: &Se3<f64>, point: &Vector3<f64>, focal: f64, at: [f64; 2]) -> Option<[f64; 2]> {
    let p = w2c.transform(point);
    (p.z > 1e-6).then(|| [focal * p.x / p.z - at[0], focal * p.y / p.z - at[1]])
}

/// One observation, linearised and scaled by the root of its weight; all zero for a point that is
/// not in front of the camera.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Jacobian {
    /// Residual.
    pub residual: Vector2<f64>,
    /// By the twist `(tau, omega)`.
    pub pose: Matrix2x6<f64>,
    /// By the position.
    pub point: Matrix2x3<f64>,
    /// By the logarithm of the focal length.
    pub focal: Vector2<f64>,
}

impl Jacobian {
    /// Derivatives of [`project`], weighted for Cauchy's loss of scale `cauchy_px`
    /// (weight `1 / (1 + |r|^2 / c^2)`).
    pub fn new(w2c: &Se3<f64>, point: &Vector3<f64>, focal: f64, at: [f64; 2], cauchy_px: f64) -> Self {
        let Some(r) = project(w2c, point, focal, at) else {
            return Self {
                residual: Vector2::zeros(),
                pose: Matrix2x6::zeros(),
                point: Matrix2x3::zeros(),
                focal: Vector2::zeros(),
            };
        };
        let p = w2c.transform(point);
        let (fz, x, y) = (focal / p.z, p.x / p.z, p.y / p.z);
        let by_camera = Matrix2x3::new(fz, 0.0, -fz * x, 0.0, fz, -fz * y);
        let turn = by_camera * -hat(&p);
        let residual = Vector2::new(r[0], r[1]);
        let scale = (1.0 / (1.0 + residual.norm_squared() / (cauchy_px * cauchy_px))).sqrt();
        let mut pose = Matrix2x6::zeros();
        pose.fixed_view_mut::<2, 3>(0, 0).copy_from(&(by_camera * scale));
        pose.fixed_view_mut::<2, 3>(0, 3).copy_from(&(turn * scale));
        Self {
            residual: residual * scale,
            pose,
            point: by_camera * w2c.rotation * scale,
            focal: Vector2::new(focal * x, focal * y) * scale,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Jacobian, project};
    use m4_core::{
        Se3, exp_so3,
        nalgebra::{Vector3, Vector6},
    };

    #[test]
    fn derivatives_match_central_differences() {
        let pose = Se3 { rotation: exp_so3(&Vector3::new(0.3, -0.5, 0.2)), translation: Vector3::new(0.2, -0.4, 3.0) };
        let (x, focal, at) = (Vector3::new(0.7, -0.3, 1.1), 420.0_f64, [30.0, -12.0]);
        // A huge scale makes all weights 1.
        let j = Jacobian::new(&pose, &x, focal, at, 1e9);
        let at_pose = |p: &Se3<f64>| project(p, &x, focal, at).expect("in front");
        let h = 1e-6;
        for k in 0..6 {
            let mut d = Vector6::zeros();
            d[k] = h;
            let (a, b) = (at_pose(&pose.retract(&d)), at_pose(&pose.retract(&-d)));
            for i in 0..2 {
                assert!(((a[i] - b[i]) / (2.0 * h) - j.pose[(i, k)]).abs() < 1e-4, "pose {k} {i}");
            }
        }
        for k in 0..3 {
            let mut d = Vector3::zeros();
            d[k] = h;
            let a = project(&pose, &(x + d), focal, at).expect("in front");
            let b = project(&pose, &(x - d), focal, at).expect("in front");
            for i in 0..2 {
                assert!(((a[i] - b[i]) / (2.0 * h) - j.point[(i, k)]).abs() < 1e-4, "point {k} {i}");
            }
        }
        let (a, b) = (
            project(&pose, &x, focal * h.exp(), at).expect("in front"),
            project(&pose, &x, focal * (-h).exp(), at).expect("in front"),
        );
        for i in 0..2 {
            assert!(((a[i] - b[i]) / (2.0 * h) - j.focal[i]).abs() < 1e-4, "focal {i}");
        }
    }

    #[test]
    fn behind_the_camera_nothing_pulls() {
        let j = Jacobian::new(&Se3::identity(), &Vector3::new(0.0, 0.0, -1.0), 400.0, [0.0, 0.0], 1.0);
        assert_eq!((j.residual.norm(), j.pose.norm(), j.point.norm()), (0.0, 0.0, 0.0));
    }
}
