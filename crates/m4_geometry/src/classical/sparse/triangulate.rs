//! Points from rays.

use m4_core::{
    Se3, median,
    nalgebra::{Matrix3, Vector3},
};

use super::bundle::Jacobian;
use super::resection::error_px;

/// A ray: world-to-camera pose and pixels from the image centre.
pub(crate) type View = (Se3<f64>, [f64; 2]);

/// A triangulated point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Triangulated {
    /// World position, in front of every camera.
    pub point: Vector3<f64>,
    /// Greatest angle between two of the rays, radians.
    pub angle_rad: f64,
    /// Median reprojection error, pixels.
    pub median_px: f64,
}

/// The point nearest to all rays, refined on the Cauchy loss of its reprojection errors.
///
/// `None` for fewer than two views, parallel rays, or a point that is behind one of the cameras.
pub(crate) fn triangulate(views: &[View], focal: f64, cauchy_px: f64) -> Option<Triangulated> {
    if views.len() < 2 {
        return None;
    }
    let mut point = nearest_to_rays(views, focal)?;
    for _ in 0..8 {
        let (mut h, mut g) = (Matrix3::zeros(), Vector3::zeros());
        for (pose, at) in views {
            let j = Jacobian::new(pose, &point, focal, *at, cauchy_px);
            h += j.point.transpose() * j.point;
            g += j.point.transpose() * j.residual;
        }
        for k in 0..3 {
            h[(k, k)] *= 1.0 + 1e-6;
        }
        let step = h.cholesky()?.solve(&g);
        point -= step;
        if step.norm() < 1e-7 * point.norm() {
            break;
        }
    }
    let mut errors = Vec::with_capacity(views.len());
    for (pose, at) in views {
        errors.push(error_px(pose, &point, focal, *at)?);
    }
    let median_px = median(&mut errors)?;
    point.iter().all(|v| v.is_finite()).then(|| Triangulated {
        point,
        angle_rad: widest_angle(views, &point),
        median_px,
    })
}

/// Linear least squares on the distances to the rays.
fn nearest_to_rays(views: &[View], focal: f64) -> Option<Vector3<f64>> {
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for (pose, at) in views {
        let direction = pose
            .rotation
            .tr_mul(&Vector3::new(at[0] / focal, at[1] / focal, 1.0))
            .normalize();
        let across = Matrix3::identity() - direction * direction.transpose();
        let centre = -pose.rotation.tr_mul(&pose.translation);
        a += across;
        b += across * centre;
    }
    let point = a.try_inverse()? * b;
    point.iter().all(|v| v.is_finite()).then_some(point)
}

/// Greatest angle at `point` between up to eight of the views, radians.
fn widest_angle(views: &[View], point: &Vector3<f64>) -> f64 {
    let step = views.len().div_ceil(8).max(1);
    let rays: Vec<Vector3<f64>> = views
        .iter()
        .step_by(step)
        .chain(views.last())
        .map(|(pose, _)| (point + pose.rotation.tr_mul(&pose.translation)).normalize())
        .collect();
    let mut widest = 0.0_f64;
    for (i, a) in rays.iter().enumerate() {
        for b in &rays[..i] {
            widest = widest.max(a.cross(b).norm().atan2(a.dot(b)));
        }
    }
    widest
}

#[cfg(test)]
mod tests {
    use super::triangulate;
    use m4_core::{
        Se3,
        nalgebra::{Matrix3, Vector3},
    };

    fn camera(x: f64) -> Se3<f64> {
        Se3 {
            rotation: Matrix3::identity(),
            translation: Vector3::new(-x, 0.0, 0.0),
        }
    }

    #[test]
    fn rays_meet_at_the_point() {
        let p = Vector3::new(0.3, -0.2, 4.0);
        let views: Vec<_> = [0.0, 0.2, 0.5]
            .map(camera)
            .map(|c| {
                let q = c.transform(&p);
                (c, [400.0 * q.x / q.z, 400.0 * q.y / q.z])
            })
            .to_vec();
        let got = triangulate(&views, 400.0, 1.0).expect("a point");
        assert!((got.point - p).norm() < 1e-9 && got.median_px < 1e-9);
        assert!((got.angle_rad - 0.5 / 4.0).abs() < 0.01, "{}", got.angle_rad);
    }

    #[test]
    fn diverging_and_parallel_rays_meet_nowhere() {
        let diverging = [(camera(0.0), [10.0, 0.0]), (camera(0.5), [60.0, 0.0])];
        assert!(triangulate(&diverging, 400.0, 1.0).is_none());
        let parallel = [(camera(0.0), [10.0, 0.0]), (camera(0.0), [10.0, 0.0])];
        assert!(triangulate(&parallel, 400.0, 1.0).is_none());
        assert!(triangulate(&parallel[..1], 400.0, 1.0).is_none());
    }
}
