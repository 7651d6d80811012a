//! Cameras that do not translate: one pose, rotations alone, or a rotation and intrinsics per frame of a lens that zooms; no points.

use super::map::{Map, classify, median_far_error};
use super::priors::{FocalSource, Lenses, Recovered};
use super::reconstruct::{Clip, MIN_TRACKS};
use super::rotation::{matches, turn};
use super::tracking::RawTrack;
use super::zoom::{Aim, MOST_PX, Zooming, range, zooming};
use super::{SparseError, stopped};
use crate::classical::reconstruction::{CameraMotion, Motion};
use m4_core::nalgebra::{Matrix3, Vector3};
use m4_core::{Intrinsics, Se3, exp_so3, log_so3};
use rayon::prelude::*;

/// One pose for all frames.
pub(crate) fn standing(tracks: &[RawTrack], frames: usize, focal: f64) -> Map {
    Map { focal, poses: vec![Some(Se3::identity()); frames], points: vec![None; tracks.len()] }
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
        Some((_, map, lost)) => Turning { map: map.clone(), lost: *lost, focal_observed: observed.is_some() },
        None => Turning { map: standing(tracks, frames, assumed), lost: 0, focal_observed: false },
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
        let refined: Vec<Matrix3<f64>> =
            (0..frames).map(|frame| refine(tracks, &directions, frame, &rotations[frame], focal, cauchy_px)).collect();
        rotations = refined;
    }
    // The world is the first camera.
    let first = rotations[0].transpose();
    let pose =
        |r: &Matrix3<f64>| Some(Se3 { rotation: exp_so3(&log_so3(&(r * first))), translation: Vector3::zeros() });
    let map = Map { focal, poses: rotations.iter().map(pose).collect(), points: vec![None; tracks.len()] };
    (map, lost)
}

/// Mean direction of a track in the world.
fn direction(track: &RawTrack, rotations: &[Matrix3<f64>], focal: f64) -> Option<Vector3<f64>> {
    let rays = (track.first..).zip(&track.seen);
    let sum: Vector3<f64> =
        rays.map(|(frame, at)| rotations[frame].tr_mul(&Vector3::new(at[0], at[1], focal).normalize())).sum();
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

/// Share of the resting tracks of a camera that moves which must rest for one that zooms. What is near tells a walk from a
/// zoom, and may be a small part of the image.
const AS_MANY: f64 = 0.9;
/// The median error may be this many times that of a camera that moves, and this many pixels more.
const AS_GOOD: (f64, f64) = (2.0, 0.05);

/// A zoom that explains the tracks, and the tracks as a lens that does not zoom would have seen them.
pub(super) struct Zoom {
    found: Zooming,
    map: Map,
    tracks: Vec<RawTrack>,
    median_px: f64,
}

impl Zoom {
    /// Whether a camera that moves instead, with a lens that does not, explains nothing more.
    pub fn explains_as_much_as(&self, moving: Option<&Recovered>, scale: f64) -> bool {
        let Some(moving) = moving else { return true };
        let resting = |motions: &mut dyn Iterator<Item = Motion>| motions.filter(|m| *m == Motion::Static).count();
        let here = resting(&mut classify(&self.map, &self.tracks).into_iter());
        let there = resting(&mut moving.sparse.tracks.iter().map(|t| t.motion));
        let median_px = AS_GOOD.0 * moving.sparse.residual_px * scale + AS_GOOD.1;
        here as f64 >= AS_MANY * there as f64 && self.median_px <= median_px.min(MOST_PX)
    }
}

/// Tracks as seen through a lens of `focal`.
fn through(tracks: &[RawTrack], aims: &[Aim], focal: f64) -> Vec<RawTrack> {
    let one = |track: &RawTrack| RawTrack {
        first: track.first,
        seen: (aims[track.first..].iter().zip(&track.seen))
            .map(|(aim, at)| at.map(|v| v * focal / aim.focal))
            .collect(),
    };
    tracks.iter().map(one).collect()
}

impl Clip<'_> {
    /// How the lens zooms, if turns and zooms alone explain the tracks.
    pub(super) fn zoom(&self, focals: &[f64]) -> Result<Option<Zoom>, SparseError> {
        let assumed = self.default_focal();
        let cauchy_px = self.limits.cauchy_px;
        stopped(self.progress)?;
        let found = zooming(&self.tracks, self.frames, focals, assumed, MIN_TRACKS, cauchy_px);
        let Some(found) = found else {
            return Ok(None);
        };
        let (least, most) = range(&found.aims);
        let focal = (least * most).sqrt();
        let pose = |aim: &Aim| Se3 { rotation: exp_so3(&log_so3(&aim.rotation)), translation: Vector3::zeros() };
        let map = Map {
            focal,
            poses: found.aims.iter().map(|aim| Some(pose(aim))).collect(),
            points: vec![None; self.tracks.len()],
        };
        let tracks = through(&self.tracks, &found.aims, focal);
        let median_px = median_far_error(&map, &tracks).unwrap_or(f64::INFINITY);
        Ok(Some(Zoom { found, map, tracks, median_px }))
    }

    /// A rotation and intrinsics per frame.
    pub(super) fn zoomed(&mut self, zoom: Zoom) -> Recovered {
        let Zoom { found, map, tracks, median_px } = zoom;
        let first = found.aims[0].focal;
        let base = self.lenses.of(0);
        let base = base.unwrap_or_else(|| Intrinsics::centred(self.width, self.height, first / self.size.scale));
        let lens = |aim: &Aim| Intrinsics { fx: base.fx * aim.focal / first, fy: base.fy * aim.focal / first, ..base };
        self.masked = through(&self.masked, &found.aims, map.focal);
        self.tracks = tracks;
        self.lenses = Lenses::Zooming(found.aims.iter().map(lens).collect());
        let note = if found.focal_observed { String::new() } else { self.focal_note() };
        let (least, most) = range(&found.aims);
        self.warn(format!(
            "the lens zooms (its field of view goes from {:.0} to {:.0} degrees, between {:.0} and {:.0}) and the camera does \
             not move, or moves straight towards a flat surface, which looks the same: a rotation and a focal length per frame \
             explain the tracks to {median_px:.2} px (working size); depth cannot be measured: film without zoom while \
             walking sideways{note}",
            self.fov_deg(first),
            self.fov_deg(found.aims[self.frames - 1].focal),
            self.fov_deg(most),
            self.fov_deg(least),
        ));
        let focal = match self.untold_focal() {
            FocalSource::Assumed if found.focal_observed => FocalSource::Estimated { sigma: None },
            other => other,
        };
        self.without_points(map, CameraMotion::RotationOnly, focal)
    }
}
