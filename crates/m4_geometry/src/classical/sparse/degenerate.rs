//! Static or only turning cameras: rotations alone, no points.

use super::map::Map;
use super::motion::median_far_error;
use super::rotation::{matches, turn};
use super::tracking::RawTrack;
use m4_core::{
    Se3, exp_so3, log_so3,
    nalgebra::{Matrix3, Vector3},
};
use rayon::prelude::*;

/// One pose for all frames.
pub(crate) fn standing(tracks: &[RawTrack], frames: usize, focal: f64) -> Map {
    Map {
        focal,
        poses: vec![Some(Se3::identity()); frames],
        points: vec![None; tracks.len()],
    }
}

/// A camera that turns in place.
#[derive(Debug, Clone)]
pub(crate) struct Turning {
    /// Rotations; no points.
    pub map: Map,
    /// Frames that took the rotation of the one before because they share too few tracks with it.
    pub lost: usize,
    /// False when the turn says so little about the focal length that the assumed one was kept.
    pub focal_observed: bool,
}

/// Rotations for the focal length among `focals` that explains the tracks best, or for `assumed` when
/// the best explains them hardly better; `cauchy_px` is the scale of the loss.
pub(crate) fn turning(
    tracks: &[RawTrack],
    frames: usize,
    focals: &[f64],
    assumed: f64,
    min_matches: usize,
    cauchy_px: f64,
) -> Turning {
    let all: Vec<(f64, Map, usize)> = focals
        .par_iter()
        .chain(rayon::iter::once(&assumed))
        .map(|&focal| {
            let (map, lost) = rotations(tracks, frames, focal, min_matches, cauchy_px);
            (median_far_error(&map, tracks).unwrap_or(f64::INFINITY), map, lost)
        })
        .collect();
    let error_assumed = all.last().map_or(f64::INFINITY, |(error, ..)| *error);
    let best = all.iter().min_by(|a, b| a.0.total_cmp(&b.0));
    let observed = best.filter(|(error, ..)| *error < 0.8 * error_assumed);
    match observed.or(all.last()) {
        Some((_, map, lost)) => Turning {
            map: map.clone(),
            lost: *lost,
            focal_observed: observed.is_some(),
        },
        None => Turning {
            map: standing(tracks, frames, assumed),
            lost: 0,
            focal_observed: false,
        },
    }
}

/// Rotations chained from frame to frame, then refined so that every track has one direction in the
/// world (alternating between directions and rotations). Frames that share fewer than `min_matches`
/// tracks with the one before keep its rotation; their number is returned.
fn rotations(tracks: &[RawTrack], frames: usize, focal: f64, min_matches: usize, cauchy_px: f64) -> (Map, usize) {
    let mut rotations = vec![Matrix3::identity(); frames];
    let mut lost = 0;
    for frame in 1..frames {
        let found = matches(tracks, frame - 1, frame);
        let enough = found.len() >= min_matches;
        let step = if enough { turn(&found, focal) } else { None };
        lost += usize::from(step.is_none());
        rotations[frame] = step.map_or(Matrix3::identity(), |t| t.rotation) * rotations[frame - 1];
    }
    for _ in 0..10 {
        let directions: Vec<Option<Vector3<f64>>> = tracks.iter().map(|t| direction(t, &rotations, focal)).collect();
        let refined: Vec<Matrix3<f64>> = (0..frames)
            .map(|frame| refine(tracks, &directions, frame, &rotations[frame], focal, cauchy_px))
            .collect();
        rotations = refined;
    }
    // The world is the first camera.
    let first = rotations[0].transpose();
    let pose = |r: &Matrix3<f64>| {
        Some(Se3 {
            rotation: exp_so3(&log_so3(&(r * first))),
            translation: Vector3::zeros(),
        })
    };
    let map = Map {
        focal,
        poses: rotations.iter().map(pose).collect(),
        points: vec![None; tracks.len()],
    };
    (map, lost)
}

/// Mean direction of a track in the world.
fn direction(track: &RawTrack, rotations: &[Matrix3<f64>], focal: f64) -> Option<Vector3<f64>> {
    let rays = (track.first..).zip(&track.seen);
    let sum: Vector3<f64> = rays
        .map(|(frame, at)| rotations[frame].tr_mul(&Vector3::new(at[0], at[1], focal).normalize()))
        .sum();
    (sum.norm() > 0.0 && track.seen.len() > 1).then(|| sum.normalize())
}

/// The rotation of one frame for given directions: a re-weighted step of Wahba's problem.
fn refine(
    tracks: &[RawTrack],
    directions: &[Option<Vector3<f64>>],
    frame: usize,
    rotation: &Matrix3<f64>,
    focal: f64,
    cauchy_px: f64,
) -> Matrix3<f64> {
    let (mut sum, mut count) = (Matrix3::zeros(), 0);
    for (track, direction) in tracks.iter().zip(directions) {
        let (Some(at), Some(d)) = (track.at(frame), direction) else {
            continue;
        };
        let ray = Vector3::new(at[0], at[1], focal).normalize();
        let error_px = focal * (rotation * d - ray).norm();
        sum += ray * d.transpose() / (1.0 + (error_px / cauchy_px).powi(2));
        count += 1;
    }
    let svd = sum.svd(true, true);
    match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) if count >= 3 => {
            let sign = (u.determinant() * v_t.determinant()).signum();
            u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t
        }
        _ => *rotation,
    }
}
