//! Cameras that do not translate: one pose, rotations alone, or a rotation and intrinsics per frame
//! of a lens that zooms; no points.

use super::map::{Map, classify, median_far_error};
use super::priors::{Lenses, Recovered};
use super::reconstruct::SparseProblem;
use super::rotation::{MIN_TRACKS, matches, nearest_rotation, ray, turn};
use super::tracking::RawTrack;
use super::zoom::{Aim, MOST_PX, Zooming, range, zooming};
use super::{SparseError, stopped};
use crate::classical::{CameraMotion, Motion};
use m4_core::nalgebra::{Matrix3, Vector3};
use m4_core::{Intrinsics, Se3, exp_so3, log_so3};
use rayon::prelude::*;

/// A camera that turns in place.
pub(crate) struct Turning {
    pub map: Map,
    /// Frames that took the rotation of the one before because they share too few tracks with it.
    pub lost: usize,
    /// False when the turn says so little about the focal length that the assumed one was kept.
    pub focal_observed: bool,
}

/// Rotations for the focal length among `focals` that explains the tracks best, or for `assumed`
/// when the best explains them hardly better; `cauchy_px` is the scale of the loss.
pub(crate) fn turning(
    tracks: &[RawTrack],
    frames: usize,
    focals: &[f64],
    assumed: f64,
    cauchy_px: f64,
) -> Turning {
    let all: Vec<(f64, Map, usize)> = focals
        .par_iter()
        .chain(rayon::iter::once(&assumed))
        .map(|&focal| {
            let (map, lost) = rotations(tracks, frames, focal, cauchy_px);
            (
                median_far_error(&map, tracks).unwrap_or(f64::INFINITY),
                map,
                lost,
            )
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
            map: Map::new(assumed, vec![Some(Se3::identity()); frames], tracks),
            lost: 0,
            focal_observed: false,
        },
    }
}

/// Rotations chained from frame to frame, then refined so that every track has one direction in the
/// world (alternating between directions and rotations). Frames that share fewer than
/// [`MIN_TRACKS`] tracks with the one before keep its rotation; their number is returned.
fn rotations(tracks: &[RawTrack], frames: usize, focal: f64, cauchy_px: f64) -> (Map, usize) {
    let mut rotations = vec![Matrix3::identity(); frames];
    let mut lost = 0;
    for frame in 1..frames {
        let matches = matches(tracks, frame - 1, frame);
        let step = if matches.len() >= MIN_TRACKS {
            turn(&matches, focal)
        } else {
            None
        };
        lost += usize::from(step.is_none());
        rotations[frame] = step.map_or(Matrix3::identity(), |t| t.rotation) * rotations[frame - 1];
    }
    for _ in 0..10 {
        let directions: Vec<Option<Vector3<f64>>> = tracks
            .iter()
            .map(|t| direction(t, &rotations, focal))
            .collect();
        for (frame, rotation) in rotations.iter_mut().enumerate() {
            *rotation = refine(tracks, &directions, frame, rotation, focal, cauchy_px);
        }
    }
    // The world is the first camera.
    let first = rotations[0].transpose();
    let pose = |r: &Matrix3<f64>| {
        Some(Se3 {
            rotation: exp_so3(&log_so3(&(r * first))),
            translation: Vector3::zeros(),
        })
    };
    (
        Map::new(focal, rotations.iter().map(pose).collect(), tracks),
        lost,
    )
}

/// Mean direction of a track in the world.
fn direction(track: &RawTrack, rotations: &[Matrix3<f64>], focal: f64) -> Option<Vector3<f64>> {
    let rays = (track.first..).zip(&track.seen);
    let sum: Vector3<f64> = rays
        .map(|(frame, at)| rotations[frame].tr_mul(&ray(*at, focal)))
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
        let ray = ray(at, focal);
        let error_px = focal * (rotation * d - ray).norm();
        sum += ray * d.transpose() / (1.0 + (error_px / cauchy_px).powi(2));
        count += 1;
    }
    if count < 3 {
        *rotation
    } else {
        nearest_rotation(sum).unwrap_or(*rotation)
    }
}

/// Share of the resting tracks of a camera that moves which must rest for one that zooms. What is
/// near tells a walk from a zoom, and may be a small part of the image.
const AS_MANY: f64 = 0.9;
/// The median error may be this many times that of a camera that moves, and this many pixels more.
const AS_GOOD: (f64, f64) = (2.0, 0.05);

/// A zoom that explains the tracks, and the tracks as a lens that does not zoom would have seen
/// them.
pub(super) struct Zoom {
    zooming: Zooming,
    map: Map,
    tracks: Vec<RawTrack>,
    median_px: f64,
}

impl Zoom {
    /// Whether a camera that moves instead, with a lens that does not, explains nothing more.
    pub fn explains_as_much_as(&self, moving: Option<&Recovered>, scale: f64) -> bool {
        let Some(moving) = moving else { return true };
        let n_own_static = classify(&self.map, &self.tracks)
            .iter()
            .filter(|m| **m == Motion::Static)
            .count();
        let n_other_static = moving
            .sparse
            .tracks
            .iter()
            .filter(|t| t.motion == Motion::Static)
            .count();
        let median_px = AS_GOOD.0 * moving.sparse.residual_px * scale + AS_GOOD.1;
        n_own_static as f64 >= AS_MANY * n_other_static as f64
            && self.median_px <= median_px.min(MOST_PX)
    }
}

fn through(tracks: &[RawTrack], aims: &[Aim], focal: f64) -> Vec<RawTrack> {
    let one = |track: &RawTrack| RawTrack {
        first: track.first,
        seen: (aims[track.first..].iter().zip(&track.seen))
            .map(|(aim, at)| at.map(|v| v * focal / aim.focal))
            .collect(),
        again: Vec::new(),
    };
    tracks.iter().map(one).collect()
}

impl SparseProblem<'_> {
    /// How the lens zooms, if turns and zooms alone explain the tracks.
    pub(super) fn zoom(&self, focals: &[f64]) -> Result<Option<Zoom>, SparseError> {
        stopped(self.progress)?;
        let (assumed, cauchy_px) = (self.default_focal(), self.limits.cauchy_px);
        let Some(zooming) = zooming(&self.tracks, self.frames, focals, assumed, cauchy_px) else {
            return Ok(None);
        };
        let (least, most) = range(&zooming.aims);
        let focal = (least * most).sqrt();
        let pose = |aim: &Aim| Se3 {
            rotation: exp_so3(&log_so3(&aim.rotation)),
            translation: Vector3::zeros(),
        };
        let map = Map::new(
            focal,
            zooming.aims.iter().map(|aim| Some(pose(aim))).collect(),
            &self.tracks,
        );
        let tracks = through(&self.tracks, &zooming.aims, focal);
        let median_px = median_far_error(&map, &tracks).unwrap_or(f64::INFINITY);
        Ok(Some(Zoom {
            zooming,
            map,
            tracks,
            median_px,
        }))
    }

    /// A rotation and intrinsics per frame.
    pub(super) fn zoomed(&mut self, zoom: Zoom) -> Recovered {
        let Zoom {
            zooming,
            map,
            tracks,
            median_px,
        } = zoom;
        let first = zooming.aims[0].focal;
        let base = self.lenses.of(0);
        let base = base.unwrap_or_else(|| {
            Intrinsics::centred(self.width, self.height, first / self.size.scale)
        });
        let lens = |aim: &Aim| Intrinsics {
            fx: base.fx * aim.focal / first,
            fy: base.fy * aim.focal / first,
            ..base
        };
        self.masked = through(&self.masked, &zooming.aims, map.focal);
        self.tracks = tracks;
        self.lenses = Lenses(zooming.aims.iter().map(lens).collect());
        let note = self.focal_note(zooming.focal_observed);
        let (least, most) = range(&zooming.aims);
        self.warn(format!(
            "the lens zooms (its field of view goes from {:.0} to {:.0} degrees, between {:.0} and {:.0}) and the camera does \
             not move, or moves straight towards a flat surface, which looks the same: a rotation and a focal length per frame \
             explain the tracks to {median_px:.2} px (working size); depth cannot be measured: film without zoom while \
             walking sideways{note}",
            self.fov_deg(first),
            self.fov_deg(zooming.aims[self.frames - 1].focal),
            self.fov_deg(most),
            self.fov_deg(least),
        ));
        self.without_points(map, CameraMotion::RotationOnly, zooming.focal_observed)
    }
}
