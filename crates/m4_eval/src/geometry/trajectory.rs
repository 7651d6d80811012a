//! Camera centres and axes after alignment, centres by a similarity (Umeyama 1991), axes by a
//! rotation.

use super::report::median_of_sorted;
use m4_core::nalgebra::{Matrix3, Vector3};
use m4_core::{Camera, Sim3, log_so3};
use serde::{Deserialize, Serialize};

/// Distances between camera centres after the best similarity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrajectoryError {
    /// Root mean square distance, units of the truth (metres if it is metric).
    pub rmse: f64,
    /// Greatest distance, units of the truth.
    pub max: f64,
    /// Length of the true path through the paired frames, units of the truth.
    pub path_length: f64,
    /// `rmse` in per cent of `path_length`.
    pub rmse_percent: f64,
    /// Units of the truth in one unit of the estimate.
    pub scale: f64,
}

/// Angles between camera axes after the best common rotation, degrees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RotationError {
    /// Mean over frames.
    pub mean_deg: f64,
    /// Median over frames.
    pub median_deg: f64,
    /// Greatest.
    pub max_deg: f64,
}

/// The rotation `Q` that minimises `sum |Q R_estimate - R_truth|^2`.
fn common_rotation(estimate: &[Camera], truth: &[Camera]) -> Option<Matrix3<f64>> {
    if estimate.is_empty() || estimate.len() != truth.len() {
        return None;
    }
    let sum: Matrix3<f64> = estimate
        .iter()
        .zip(truth)
        .map(|(e, t)| t.c2w.rotation * e.c2w.rotation.transpose())
        .sum();
    let svd = sum.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = if (u * v_t).determinant() < 0.0 {
        -1.0
    } else {
        1.0
    };
    Some(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t)
}

/// The similarity that takes the cameras of an estimate to those of the truth: the rotation from
/// the axes, which determine it even where all centres lie on a line, scale and translation from
/// the centres. `None` for fewer than three pairs, or where a path has no extent.
pub fn placement(estimate: &[Camera], truth: &[Camera]) -> Option<Sim3> {
    let rotation = common_rotation(estimate, truth).filter(|_| estimate.len() >= 3)?;
    let mean = |cameras: &[Camera]| {
        cameras.iter().map(Camera::centre).sum::<Vector3<f64>>() / cameras.len() as f64
    };
    let (from, to) = (mean(estimate), mean(truth));
    let (mut along, mut square) = (0.0, 0.0);
    for (e, t) in estimate.iter().zip(truth) {
        let turned = rotation * (e.centre() - from);
        along += turned.dot(&(t.centre() - to));
        square += turned.norm_squared();
    }
    let scale = along / square;
    (scale.is_finite() && scale > 0.0).then(|| Sim3 {
        scale,
        rotation,
        translation: to - rotation * from * scale,
    })
}

/// Whether points are apart. Identical centres differ by rounding alone; a path of that length has
/// no shape to align.
pub(super) fn has_extent(points: &[Vector3<f64>]) -> bool {
    let Some(first) = points.first() else {
        return false;
    };
    let spread = points
        .iter()
        .map(|p| (p - first).norm())
        .fold(0.0, f64::max);
    let size = points.iter().map(|p| p.norm()).fold(1e-6, f64::max);
    spread > 1e-9 * size
}

/// `None` if either path has no extent.
pub(super) fn trajectory_error(estimate: &[Camera], truth: &[Camera]) -> Option<TrajectoryError> {
    let centres = |cameras: &[Camera]| cameras.iter().map(Camera::centre).collect::<Vec<_>>();
    let (estimate, truth) = (centres(estimate), centres(truth));
    let path_length: f64 = truth.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    if ![&estimate, &truth].iter().all(|p| has_extent(p)) {
        return None;
    }
    let sim = Sim3::umeyama(&estimate, &truth)?;
    let distances: Vec<f64> = estimate
        .iter()
        .zip(&truth)
        .map(|(e, t)| (sim.transform(e) - t).norm())
        .collect();
    let rmse = (distances.iter().map(|d| d * d).sum::<f64>() / distances.len() as f64).sqrt();
    Some(TrajectoryError {
        rmse,
        max: distances.iter().copied().fold(0.0, f64::max),
        path_length,
        rmse_percent: 100.0 * rmse / path_length,
        scale: sim.scale,
    })
}

pub(super) fn rotation_error(estimate: &[Camera], truth: &[Camera]) -> Option<RotationError> {
    let common = common_rotation(estimate, truth)?;
    let mut angles: Vec<f64> = estimate
        .iter()
        .zip(truth)
        .map(|(e, t)| {
            log_so3(&((common * e.c2w.rotation).transpose() * t.c2w.rotation))
                .norm()
                .to_degrees()
        })
        .collect();
    angles.sort_by(f64::total_cmp);
    Some(RotationError {
        mean_deg: angles.iter().sum::<f64>() / angles.len() as f64,
        median_deg: median_of_sorted(&angles),
        max_deg: angles[angles.len() - 1],
    })
}

#[cfg(test)]
mod tests {
    use super::{rotation_error, trajectory_error};
    use m4_core::nalgebra::{Vector3, Vector6};
    use m4_core::{Camera, Intrinsics, Se3, Sim3, exp_so3};

    fn cameras(n: usize) -> Vec<Camera> {
        (0..n)
            .map(|i| {
                let a = i as f64 * 0.7;
                let twist = Vector6::new(
                    a.sin(),
                    0.5 * a.cos(),
                    0.2 * a,
                    0.1 * a,
                    -0.2 * a.sin(),
                    0.05 * a,
                );
                Camera {
                    intrinsics: Intrinsics::centred(64, 48, 60.0),
                    c2w: Se3::identity().retract(&twist),
                }
            })
            .collect()
    }

    fn moved(cameras: &[Camera], sim: &Sim3) -> Vec<Camera> {
        cameras
            .iter()
            .map(|c| Camera {
                c2w: Se3 {
                    rotation: sim.rotation * c.c2w.rotation,
                    translation: sim.transform(&c.c2w.translation),
                },
                ..*c
            })
            .collect()
    }

    #[test]
    fn a_similarity_of_the_truth_has_no_error() {
        let truth = cameras(12);
        let sim = Sim3 {
            scale: 0.3,
            rotation: exp_so3(&Vector3::new(0.4, -1.0, 0.7)),
            translation: Vector3::new(3.0, -1.0, 2.0),
        };
        let estimate = moved(&truth, &sim);
        let t = trajectory_error(&estimate, &truth).unwrap();
        assert!(t.rmse < 1e-9 && (t.scale - 1.0 / 0.3).abs() < 1e-9, "{t:?}");
        assert!(rotation_error(&estimate, &truth).unwrap().max_deg < 1e-6);
    }

    #[test]
    fn trajectory_error_matches_a_known_offset() {
        // Truth on the x axis at 0, 1, 2, 3; the estimate alternates by +-h in y. The best
        // similarity of points (x, +-h) onto (x, 0): by symmetry the mean is kept and the residual
        // is computed from the covariance; for the pattern +,-,-,+ the cross terms vanish, so the
        // rotation is none, scale = 5/4 / (5/4 + h^2), and the mean square error is h^2 5/4 / (5/4
        // + h^2).
        let h = 0.1;
        let at = |x: f64, y: f64| Camera {
            intrinsics: Intrinsics::centred(64, 48, 60.0),
            c2w: Se3 {
                translation: Vector3::new(x, y, 0.0),
                ..Se3::identity()
            },
        };
        let truth: Vec<Camera> = (0..4).map(|i| at(f64::from(i), 0.0)).collect();
        let estimate: Vec<Camera> = [h, -h, -h, h]
            .iter()
            .enumerate()
            .map(|(i, &y)| at(i as f64, y))
            .collect();
        let got = trajectory_error(&estimate, &truth).unwrap();
        let want = (h * h * 1.25 / (1.25 + h * h)).sqrt();
        assert!(
            (got.rmse - want).abs() < 1e-9,
            "{} where {want} was expected",
            got.rmse
        );
        assert!((got.path_length - 3.0).abs() < 1e-12);
        assert!((got.rmse_percent - 100.0 * want / 3.0).abs() < 1e-9);
    }

    #[test]
    fn opposite_turns_are_measured_in_degrees() {
        let truth = cameras(2);
        let mut estimate = truth.clone();
        let turn = |deg: f64| exp_so3(&Vector3::new(0.0, 0.0, deg.to_radians()));
        estimate[0].c2w.rotation = turn(3.0) * truth[0].c2w.rotation;
        estimate[1].c2w.rotation = turn(-3.0) * truth[1].c2w.rotation;
        let got = rotation_error(&estimate, &truth).unwrap();
        assert!(
            (got.mean_deg - 3.0).abs() < 1e-6 && (got.median_deg - 3.0).abs() < 1e-6,
            "{got:?}"
        );
    }

    #[test]
    fn static_camera_has_no_trajectory_error() {
        let still = vec![cameras(1)[0]; 5];
        assert!(trajectory_error(&still, &cameras(5)).is_none());
    }
}
