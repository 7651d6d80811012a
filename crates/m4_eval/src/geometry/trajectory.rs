//! Camera centres and axes after alignment, and errors of camera paths as the program `evo` defines them (Grupp, "evo: Python
//! package for the evaluation of odometry and SLAM").
//!
//! The absolute error compares poses of one frame after an alignment of the whole path (Umeyama 1991, over camera centres); the
//! relative error compares the motions from one frame to another (Sturm et al., IROS 2012): `(T_i^-1 T_j)^-1 (E_i^-1 E_j)` for truth
//! `T` and estimate `E`. Poses are camera to world; lengths are in units of the truth where the alignment scales, angles in degrees.

use super::report::{GeometryError, median_of_sorted, no_frames, not_finite};
use m4_core::nalgebra::{Matrix3, Vector3};
use m4_core::{Camera, Se3, Sim3, log_so3};
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
    let sum: Matrix3<f64> = estimate.iter().zip(truth).map(|(e, t)| t.c2w.rotation * e.c2w.rotation.transpose()).sum();
    let svd = sum.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = if (u * v_t).determinant() < 0.0 { -1.0 } else { 1.0 };
    Some(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t)
}

/// The similarity that takes the cameras of an estimate to those of the truth: the rotation from the axes, which determine it even where all
/// centres lie on a line, scale and translation from the centres. `None` for fewer than three pairs, or where a path has no extent.
pub fn placement(estimate: &[Camera], truth: &[Camera]) -> Option<Sim3> {
    let rotation = common_rotation(estimate, truth).filter(|_| estimate.len() >= 3)?;
    let mean = |cameras: &[Camera]| cameras.iter().map(Camera::centre).sum::<Vector3<f64>>() / cameras.len() as f64;
    let (from, to) = (mean(estimate), mean(truth));
    let (mut along, mut square) = (0.0, 0.0);
    for (e, t) in estimate.iter().zip(truth) {
        let turned = rotation * (e.centre() - from);
        along += turned.dot(&(t.centre() - to));
        square += turned.norm_squared();
    }
    let scale = along / square;
    (scale.is_finite() && scale > 0.0).then(|| Sim3 { scale, rotation, translation: to - rotation * from * scale })
}

/// Whether points are apart. Identical centres differ by rounding alone; a path of that length has no shape to align.
pub(super) fn has_extent(points: &[Vector3<f64>]) -> bool {
    let Some(first) = points.first() else {
        return false;
    };
    let spread = points.iter().map(|p| (p - first).norm()).fold(0.0, f64::max);
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
    let distances: Vec<f64> = estimate.iter().zip(&truth).map(|(e, t)| (sim.transform(e) - t).norm()).collect();
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
        .map(|(e, t)| log_so3(&((common * e.c2w.rotation).transpose() * t.c2w.rotation)).norm().to_degrees())
        .collect();
    angles.sort_by(f64::total_cmp);
    Some(RotationError {
        mean_deg: angles.iter().sum::<f64>() / angles.len() as f64,
        median_deg: median_of_sorted(&angles),
        max_deg: angles[angles.len() - 1],
    })
}

/// Alignment of the estimated path before comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PathAlignment {
    /// Nothing.
    None,
    /// It is rotated and moved (`evo_ape -a`): for paths whose unit is known.
    Se3,
    /// It is rotated, moved and scaled (`evo_ape -as`): for paths from one moving camera.
    Sim3,
}

/// Statistics of a set of errors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ErrorStatistics {
    /// Root of the mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// The middle one, or the mean of the two middle ones.
    pub median: f64,
    /// Standard deviation of all of them (not of a sample).
    pub std: f64,
    /// Least.
    pub min: f64,
    /// Greatest.
    pub max: f64,
}

impl ErrorStatistics {
    /// Computes the statistics of at least one error.
    fn of(mut errors: Vec<f64>) -> Self {
        let n = errors.len() as f64;
        let square = errors.iter().map(|e| e * e).sum::<f64>() / n;
        let mean = errors.iter().sum::<f64>() / n;
        let std = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n).sqrt();
        errors.sort_by(f64::total_cmp);
        Self {
            rmse: square.sqrt(),
            mean,
            median: median_of_sorted(&errors),
            std,
            min: errors[0],
            max: errors[errors.len() - 1],
        }
    }
}

/// Errors of the poses of a path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AbsoluteError {
    /// The alignment.
    pub alignment: PathAlignment,
    /// Units of the truth in one unit of the estimate; 1 where the alignment does not scale.
    pub scale: f64,
    /// Distances of camera centres (the absolute trajectory error).
    pub translation: ErrorStatistics,
    /// Angles between camera axes, degrees, after the alignment that fits the centres.
    pub rotation_deg: ErrorStatistics,
}

/// Errors of the motions between frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RelativeError {
    /// The alignment; only its scale matters here.
    pub alignment: PathAlignment,
    /// Frames from the first to the second of a pair; the next pair begins where one ends.
    pub delta_frames: usize,
    /// Pairs.
    pub pairs: usize,
    /// Lengths of the differences of the motions.
    pub translation: ErrorStatistics,
    /// Their angles, degrees.
    pub rotation_deg: ErrorStatistics,
}

/// The absolute error of `estimate`, whose poses are of the same frames as those of `truth`.
///
/// # Errors
///
/// [`GeometryError`] if the paths have no poses, other numbers of them, or poses that are not finite, or if a path that is to be aligned
/// has no extent.
pub fn absolute_error(
    estimate: &[Se3<f64>],
    truth: &[Se3<f64>],
    alignment: PathAlignment,
) -> Result<AbsoluteError, GeometryError> {
    let (aligned, scale) = aligned(estimate, truth, alignment)?;
    let apart = aligned.iter().zip(truth).map(|(e, t)| t.inverse().compose(e));
    let apart: Vec<Se3<f64>> = apart.collect();
    Ok(AbsoluteError { alignment, scale, translation: lengths(&apart), rotation_deg: angles(&apart) })
}

/// The relative error of `estimate`, whose poses are of the same frames as those of `truth`, over pairs that lie `delta_frames` apart
/// (1 for neighbours).
///
/// # Errors
///
/// [`GeometryError`] as [`absolute_error`], or if there is no such pair.
pub fn relative_error(
    estimate: &[Se3<f64>],
    truth: &[Se3<f64>],
    alignment: PathAlignment,
    delta_frames: usize,
) -> Result<RelativeError, GeometryError> {
    let (aligned, _) = aligned(estimate, truth, alignment)?;
    let delta = delta_frames.max(1);
    let pairs = (truth.len() - 1) / delta;
    if pairs == 0 || delta_frames == 0 {
        return Err(GeometryError(format!(
            "a path of {} poses has no two that lie {delta_frames} frames apart; give a delta from 1 to its length",
            truth.len()
        )));
    }
    let motion = |path: &[Se3<f64>], i: usize| path[i * delta].inverse().compose(&path[(i + 1) * delta]);
    let apart = (0..pairs).map(|i| motion(truth, i).inverse().compose(&motion(&aligned, i)));
    let apart: Vec<Se3<f64>> = apart.collect();
    Ok(RelativeError { alignment, delta_frames, pairs, translation: lengths(&apart), rotation_deg: angles(&apart) })
}

fn lengths(motions: &[Se3<f64>]) -> ErrorStatistics {
    ErrorStatistics::of(motions.iter().map(|m| m.translation.norm()).collect())
}

fn angles(motions: &[Se3<f64>]) -> ErrorStatistics {
    let angle = |m: &Se3<f64>| log_so3(&m.rotation).norm().to_degrees();
    ErrorStatistics::of(motions.iter().map(angle).collect())
}

/// The estimate after the alignment, and its scale.
fn aligned(
    estimate: &[Se3<f64>],
    truth: &[Se3<f64>],
    alignment: PathAlignment,
) -> Result<(Vec<Se3<f64>>, f64), GeometryError> {
    for (which, path) in [("estimate", estimate), ("truth", truth)] {
        if path.is_empty() {
            return Err(no_frames(which));
        }
        let finite = |p: &Se3<f64>| p.rotation.iter().chain(p.translation.iter()).all(|v| v.is_finite());
        if let Some(i) = path.iter().position(|p| !finite(p)) {
            return Err(not_finite("the pose", &format!("number {i}"), which));
        }
    }
    if estimate.len() != truth.len() {
        return Err(GeometryError(format!(
            "the estimate has {} poses and the ground truth {}; give the poses of the same frames",
            estimate.len(),
            truth.len()
        )));
    }
    let centres = |path: &[Se3<f64>]| path.iter().map(|p| p.translation).collect::<Vec<Vector3<f64>>>();
    let fit = || {
        let (from, to) = (centres(estimate), centres(truth));
        let extent = has_extent(&from) && has_extent(&to);
        let sim = extent.then(|| Sim3::umeyama(&from, &to)).flatten();
        sim.map(|sim| (sim, from, to)).ok_or_else(|| {
            let what = "one of the paths has no extent, so there is nothing to align; compare without alignment, or rotations alone";
            GeometryError(what.to_owned())
        })
    };
    let sim = match alignment {
        PathAlignment::None => Sim3::identity(),
        PathAlignment::Sim3 => fit()?.0,
        PathAlignment::Se3 => {
            // the best rotation does not depend on the scale
            let (sim, from, to) = fit()?;
            let mean = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / points.len() as f64;
            Sim3 { scale: 1.0, translation: mean(&to) - sim.rotation * mean(&from), ..sim }
        }
    };
    let moved = |p: &Se3<f64>| Se3 { rotation: sim.rotation * p.rotation, translation: sim.transform(&p.translation) };
    Ok((estimate.iter().map(moved).collect(), sim.scale))
}

#[cfg(test)]
mod tests {
    use super::{PathAlignment, absolute_error, relative_error, rotation_error, trajectory_error};
    use m4_core::nalgebra::{Vector3, Vector6};
    use m4_core::{Camera, Intrinsics, Se3, Sim3, exp_so3};

    fn cameras(n: usize) -> Vec<Camera> {
        (0..n)
            .map(|i| {
                let a = i as f64 * 0.7;
                let twist = Vector6::new(a.sin(), 0.5 * a.cos(), 0.2 * a, 0.1 * a, -0.2 * a.sin(), 0.05 * a);
                Camera { intrinsics: Intrinsics::centred(64, 48, 60.0), c2w: Se3::identity().retract(&twist) }
            })
            .collect()
    }

    fn moved(cameras: &[Camera], sim: &Sim3) -> Vec<Camera> {
        cameras
            .iter()
            .map(|c| Camera {
                c2w: Se3 { rotation: sim.rotation * c.c2w.rotation, translation: sim.transform(&c.c2w.translation) },
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
        // Truth on the x axis at 0, 1, 2, 3; the estimate alternates by +-h in y. The best similarity
        // of points (x, +-h) onto (x, 0): by symmetry the mean is kept and the residual is computed
        // from the covariance; for the pattern +,-,-,+ the cross terms vanish, so the rotation is none,
        // scale = 5/4 / (5/4 + h^2), and the mean square error is h^2 5/4 / (5/4 + h^2).
        let h = 0.1;
        let at = |x: f64, y: f64| Camera {
            intrinsics: Intrinsics::centred(64, 48, 60.0),
            c2w: Se3 { translation: Vector3::new(x, y, 0.0), ..Se3::identity() },
        };
        let truth: Vec<Camera> = (0..4).map(|i| at(f64::from(i), 0.0)).collect();
        let estimate: Vec<Camera> = [h, -h, -h, h].iter().enumerate().map(|(i, &y)| at(i as f64, y)).collect();
        let got = trajectory_error(&estimate, &truth).unwrap();
        let want = (h * h * 1.25 / (1.25 + h * h)).sqrt();
        assert!((got.rmse - want).abs() < 1e-9, "{} where {want} was expected", got.rmse);
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
        assert!((got.mean_deg - 3.0).abs() < 1e-6 && (got.median_deg - 3.0).abs() < 1e-6, "{got:?}");
    }

    #[test]
    fn static_camera_has_no_trajectory_error() {
        let still = vec![cameras(1)[0]; 5];
        assert!(trajectory_error(&still, &cameras(5)).is_none());
    }

    fn path(n: usize) -> Vec<Se3<f64>> {
        let pose = |i: usize| {
            let a = i as f64 * 0.4;
            Se3::identity().retract(&Vector6::new(a.sin(), a.cos(), 0.3 * a, 0.1 * a, 0.0, 0.2 * a.sin()))
        };
        (0..n).map(pose).collect()
    }

    #[test]
    fn one_outlier_pose_counts_in_two_relative_motions() {
        let truth = path(9);
        let mut estimate = truth.clone();
        estimate[4] = estimate[4].retract(&Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.1));
        let relative = relative_error(&estimate, &truth, PathAlignment::None, 1).unwrap();
        assert_eq!(relative.pairs, 8);
        let want = 0.1f64.to_degrees();
        assert!((relative.rotation_deg.max - want).abs() < 1e-6 && relative.rotation_deg.median < 1e-6);
        assert!((relative.rotation_deg.mean - want / 4.0).abs() < 1e-6);
        let absolute = absolute_error(&estimate, &truth, PathAlignment::None).unwrap();
        assert!((absolute.rotation_deg.mean - want / 9.0).abs() < 1e-6);
    }

    #[test]
    fn incomparable_trajectories_are_rejected() {
        let truth = path(5);
        let still = vec![truth[0]; 5];
        let absolute = |estimate: &[Se3<f64>], alignment| absolute_error(estimate, &truth, alignment);
        let mut bad = truth.clone();
        bad[3].rotation[(1, 1)] = f64::NAN;
        for (estimate, alignment, reason) in [
            (&still[..], PathAlignment::Sim3, "no extent"),
            (&still[..], PathAlignment::Se3, "no extent"),
            (&truth[1..], PathAlignment::None, "4 poses and the ground truth 5"),
            (&[], PathAlignment::None, "the estimate has no frames"),
            (&bad[..], PathAlignment::None, "number 3"),
        ] {
            let error = absolute(estimate, alignment).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
        assert!(absolute(&still, PathAlignment::None).unwrap().translation.max > 0.1);
        for delta in [0, 5] {
            let error = relative_error(&truth, &truth, PathAlignment::None, delta).unwrap_err().to_string();
            assert!(error.contains("5 poses"), "{error}");
        }
    }
}
