//! Errors of camera paths as the program `evo` defines them (Grupp, "evo: Python package for the
//! evaluation of odometry and SLAM").
//!
//! The absolute error compares poses of one frame after an alignment of the whole path (Umeyama
//! 1991, over camera centres); the relative error compares the motions from one frame to another
//! (Sturm et al., IROS 2012): `(T_i^-1 T_j)^-1 (E_i^-1 E_j)` for truth `T` and estimate `E`. Poses
//! are camera to world; lengths are in units of the truth where the alignment scales, angles in
//! degrees.

use super::report::{GeometryError, median_of_sorted, no_frames, not_finite};
use super::trajectory::has_extent;
use m4_core::nalgebra::Vector3;
use m4_core::{Se3, Sim3, log_so3};
use serde::{Deserialize, Serialize};

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
/// [`GeometryError`] if the paths have no poses, other numbers of them, or poses that are not
/// finite, or if a path that is to be aligned has no extent.
pub fn absolute_error(
    estimate: &[Se3<f64>],
    truth: &[Se3<f64>],
    alignment: PathAlignment,
) -> Result<AbsoluteError, GeometryError> {
    let (aligned, scale) = aligned(estimate, truth, alignment)?;
    let apart = aligned
        .iter()
        .zip(truth)
        .map(|(e, t)| t.inverse().compose(e));
    let apart: Vec<Se3<f64>> = apart.collect();
    Ok(AbsoluteError {
        alignment,
        scale,
        translation: lengths(&apart),
        rotation_deg: angles(&apart),
    })
}

/// The relative error of `estimate`, whose poses are of the same frames as those of `truth`, over
/// pairs that lie `delta_frames` apart (1 for neighbours).
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
    let motion =
        |path: &[Se3<f64>], i: usize| path[i * delta].inverse().compose(&path[(i + 1) * delta]);
    let apart = (0..pairs).map(|i| motion(truth, i).inverse().compose(&motion(&aligned, i)));
    let apart: Vec<Se3<f64>> = apart.collect();
    Ok(RelativeError {
        alignment,
        delta_frames,
        pairs,
        translation: lengths(&apart),
        rotation_deg: angles(&apart),
    })
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
        let finite = |p: &Se3<f64>| {
            p.rotation
                .iter()
                .chain(p.translation.iter())
                .all(|v| v.is_finite())
        };
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
    let centres = |path: &[Se3<f64>]| {
        path.iter()
            .map(|p| p.translation)
            .collect::<Vec<Vector3<f64>>>()
    };
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
            let mean =
                |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / points.len() as f64;
            Sim3 {
                scale: 1.0,
                translation: mean(&to) - sim.rotation * mean(&from),
                ..sim
            }
        }
    };
    let moved = |p: &Se3<f64>| Se3 {
        rotation: sim.rotation * p.rotation,
        translation: sim.transform(&p.translation),
    };
    Ok((estimate.iter().map(moved).collect(), sim.scale))
}

#[cfg(test)]
mod tests {
    use super::{PathAlignment, absolute_error, relative_error};
    use m4_core::Se3;
    use m4_core::nalgebra::Vector6;

    fn path(n: usize) -> Vec<Se3<f64>> {
        let pose = |i: usize| {
            let a = i as f64 * 0.4;
            Se3::identity().retract(&Vector6::new(
                a.sin(),
                a.cos(),
                0.3 * a,
                0.1 * a,
                0.0,
                0.2 * a.sin(),
            ))
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
        assert!(
            (relative.rotation_deg.max - want).abs() < 1e-6 && relative.rotation_deg.median < 1e-6
        );
        assert!((relative.rotation_deg.mean - want / 4.0).abs() < 1e-6);
        let absolute = absolute_error(&estimate, &truth, PathAlignment::None).unwrap();
        assert!((absolute.rotation_deg.mean - want / 9.0).abs() < 1e-6);
    }

    #[test]
    fn incomparable_trajectories_are_rejected() {
        let truth = path(5);
        let still = vec![truth[0]; 5];
        let absolute =
            |estimate: &[Se3<f64>], alignment| absolute_error(estimate, &truth, alignment);
        let mut bad = truth.clone();
        bad[3].rotation[(1, 1)] = f64::NAN;
        for (estimate, alignment, reason) in [
            (&still[..], PathAlignment::Sim3, "no extent"),
            (&still[..], PathAlignment::Se3, "no extent"),
            (
                &truth[1..],
                PathAlignment::None,
                "4 poses and the ground truth 5",
            ),
            (&[], PathAlignment::None, "the estimate has no frames"),
            (&bad[..], PathAlignment::None, "number 3"),
        ] {
            let error = absolute(estimate, alignment).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
        assert!(
            absolute(&still, PathAlignment::None)
                .unwrap()
                .translation
                .max
                > 0.1
        );
        for delta in [0, 5] {
            let error = relative_error(&truth, &truth, PathAlignment::None, delta)
                .unwrap_err()
                .to_string();
            assert!(error.contains("5 poses"), "{error}");
        }
    }
}
