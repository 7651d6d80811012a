//! The pose of a frame from points whose positions are known, starting nearby.

use m4_core::{
    Se3,
    nalgebra::{Matrix6, Vector3, Vector6},
};

use super::bundle::Jacobian;

/// A sighting of a known point: position and pixels from the image centre.
pub(crate) type Sighting = (Vector3<f64>, [f64; 2]);

/// What [`resect`] found.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Resection {
    /// World to camera.
    pub pose: Se3<f64>,
    /// Sightings within `inlier_px`.
    pub inliers: usize,
}

/// Graduated non-convexity: the Cauchy scale shrinks from 16 `inlier_px` to `inlier_px / 2`, with
/// Levenberg-Marquardt steps on each.
///
/// Video gives a good start (the pose of a neighbouring frame), which is why no minimal solver is
/// needed; the wide first scale tolerates that most points are off by tens of pixels.
pub(crate) fn resect(sightings: &[Sighting], focal: f64, start: &Se3<f64>, inlier_px: f64) -> Resection {
    let mut pose = *start;
    for scale in [16.0, 6.0, 2.0, 0.5] {
        pose = descend(sightings, focal, &pose, scale * inlier_px);
    }
    let inliers = sightings
        .iter()
        .filter(|(x, at)| error_px(&pose, x, focal, *at).is_some_and(|e| e < inlier_px))
        .count();
    Resection { pose, inliers }
}

/// Distance between the projection of `x` and `at`; `None` for points that are not in front.
pub(crate) fn error_px(w2c: &Se3<f64>, x: &Vector3<f64>, focal: f64, at: [f64; 2]) -> Option<f64> {
    let p = w2c.transform(x);
    (p.z > 1e-6).then(|| (focal * p.x / p.z - at[0]).hypot(focal * p.y / p.z - at[1]))
}

/// Levenberg-Marquardt steps under Cauchy's loss.
pub(crate) fn descend(sightings: &[Sighting], focal: f64, start: &Se3<f64>, cauchy_px: f64) -> Se3<f64> {
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
            let j = Jacobian::new(&pose, x, focal, *at, cauchy_px);
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
    use super::resect;
    use m4_core::{
        CounterRng, Se3, exp_so3, log_so3,
        nalgebra::{Vector3, Vector6},
    };

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
        let found = resect(&sightings, focal, &start, 2.0);
        let turn = log_so3(&(found.pose.rotation * truth.rotation.transpose())).norm();
        assert!(turn < 2e-3 && (found.pose.translation - truth.translation).norm() < 0.01);
        assert!(found.inliers >= 75, "{}", found.inliers);
    }
}
