//! Points from rays, and the pose of a frame from points whose positions are known, starting
//! nearby.

use super::INLIER_PX;
use super::bundle::{Jacobian, project};
use super::lens::Bend;
use m4_core::nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use m4_core::{Se3, median};

/// A ray: world-to-camera pose and pixels from the image centre.
pub(crate) type Ray = (Se3<f64>, [f64; 2]);

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
pub(crate) fn triangulate(views: &[Ray], focal: f64, cauchy_px: f64) -> Option<Triangulated> {
    if views.len() < 2 {
        return None;
    }
    let mut point = nearest_to_rays(views, focal)?;
    for _ in 0..8 {
        let (mut h, mut g) = (Matrix3::zeros(), Vector3::zeros());
        for (pose, at) in views {
            let j = Jacobian::new(pose, &point, focal, Bend::NONE, *at, cauchy_px);
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
    let errors: Option<Vec<f64>> = views
        .iter()
        .map(|(pose, at)| error_px(pose, &point, focal, *at))
        .collect();
    let median_px = median(&mut errors?)?;
    point.iter().all(|v| v.is_finite()).then(|| Triangulated {
        point,
        angle_rad: widest_angle(views, &point),
        median_px,
    })
}

/// Linear least squares on the distances to the rays.
fn nearest_to_rays(views: &[Ray], focal: f64) -> Option<Vector3<f64>> {
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
fn widest_angle(views: &[Ray], point: &Vector3<f64>) -> f64 {
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

/// A sighting of a known point: position and pixels from the image centre.
pub(crate) type Sighting = (Vector3<f64>, [f64; 2]);

/// The pose (world to camera) that agrees with most sightings, and how many are within
/// [`INLIER_PX`].
///
/// Graduated non-convexity: the Cauchy scale shrinks from 16 [`INLIER_PX`] to half of it, with
/// Levenberg-Marquardt steps on each.
///
/// Video gives a good start (the pose of a neighbouring frame), which is why no minimal solver is
/// needed; the wide first scale tolerates that most points are off by tens of pixels.
pub(crate) fn resect(sightings: &[Sighting], focal: f64, start: &Se3<f64>) -> (Se3<f64>, usize) {
    let mut pose = *start;
    for scale in [16.0, 6.0, 2.0, 0.5] {
        pose = descend(sightings, focal, &pose, scale * INLIER_PX);
    }
    let inliers = sightings
        .iter()
        .filter(|(x, at)| error_px(&pose, x, focal, *at).is_some_and(|e| e < INLIER_PX))
        .count();
    (pose, inliers)
}

/// Distance between the projection of `x` and `at`; `None` for points that are not in front.
pub(crate) fn error_px(w2c: &Se3<f64>, x: &Vector3<f64>, focal: f64, at: [f64; 2]) -> Option<f64> {
    project(w2c, x, focal, Bend::NONE, at).map(|r| r[0].hypot(r[1]))
}

/// Levenberg-Marquardt steps under Cauchy's loss.
pub(crate) fn descend(
    sightings: &[Sighting],
    focal: f64,
    start: &Se3<f64>,
    cauchy_px: f64,
) -> Se3<f64> {
    let cost = |pose: &Se3<f64>| -> f64 {
        let loss = |e: Option<f64>| (e.unwrap_or(100.0) / cauchy_px).powi(2).ln_1p();
        sightings
            .iter()
            .map(|(x, at)| loss(error_px(pose, x, focal, *at)))
            .sum()
    };
    let (mut pose, mut best, mut damping) = (*start, cost(start), 1e-3);
    for _ in 0..10 {
        let (mut h, mut g) = (Matrix6::zeros(), Vector6::zeros());
        for (x, at) in sightings {
            let j = Jacobian::new(&pose, x, focal, Bend::NONE, *at, cauchy_px);
            h += j.pose.transpose() * j.pose;
            g += j.pose.transpose() * j.residual;
        }
        for k in 0..6 {
            h[(k, k)] += damping * h[(k, k)] + 1e-12;
        }
        let Some(factor) = h.cholesky() else { break };
        let step = -factor.solve(&g);
        let trial = pose.retract(&step);
        let trial_cost = cost(&trial);
        if trial_cost < best {
            let small = best - trial_cost < 1e-6 * best;
            (pose, best, damping) = (trial, trial_cost, damping * 0.2);
            if small {
                break;
            }
        } else {
            damping *= 8.0;
            if damping > 1e6 {
                break;
            }
        }
    }
    pose
}

#[cfg(test)]
mod tests {
    use super::{resect, triangulate};
    use m4_core::nalgebra::{Matrix3, Vector3, Vector6};
    use m4_core::{CounterRng, Se3, exp_so3, log_so3};

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
        assert!(
            (got.angle_rad - 0.5 / 4.0).abs() < 0.01,
            "{}",
            got.angle_rad
        );
    }

    #[test]
    fn diverging_and_parallel_rays_meet_nowhere() {
        let diverging = [(camera(0.0), [10.0, 0.0]), (camera(0.5), [60.0, 0.0])];
        assert!(triangulate(&diverging, 400.0, 1.0).is_none());
        let parallel = [(camera(0.0), [10.0, 0.0]), (camera(0.0), [10.0, 0.0])];
        assert!(triangulate(&parallel, 400.0, 1.0).is_none());
        assert!(triangulate(&parallel[..1], 400.0, 1.0).is_none());
    }

    #[test]
    fn a_pose_is_found_among_a_third_of_wrong_sightings() {
        let focal = 400.0;
        let truth = Se3 {
            rotation: exp_so3(&Vector3::new(0.1, 0.3, -0.1)),
            translation: Vector3::new(0.2, 0.0, 5.0),
        };
        let mut rng = CounterRng::new(4, 0, 0);
        let sightings: Vec<_> = (0..120)
            .map(|i| {
                let x = Vector3::from_fn(|_, _| rng.normal());
                let p = truth.transform(&x);
                let off = if i % 3 == 0 { 40.0 } else { 0.3 };
                (
                    x,
                    [
                        focal * p.x / p.z + off * rng.normal(),
                        focal * p.y / p.z + off * rng.normal(),
                    ],
                )
            })
            .collect();
        let start = truth.retract(&Vector6::new(0.1, -0.1, 0.2, 0.04, -0.05, 0.03));
        let (pose, inliers) = resect(&sightings, focal, &start);
        let turn = log_so3(&(pose.rotation * truth.rotation.transpose())).norm();
        assert!(turn < 2e-3 && (pose.translation - truth.translation).norm() < 0.01);
        assert!(inliers >= 75, "{inliers}");
    }
}
