//! Assembles the result for a zooming, not translating camera: a rotation and intrinsics per frame.

use super::map::Map;
use super::motion::{classify, median_far_error};
use super::priors::{FocalSource, Lenses, Recovered};
use super::reconstruct::{Clip, MIN_TRACKS};
use super::tracking::RawTrack;
use super::zoom::{Aim, MOST_PX, Zooming, range, zooming};
use super::{SparseError, stopped};
use crate::classical::reconstruction::{CameraMotion, Motion};
use m4_core::{Intrinsics, Se3, exp_so3, log_so3, nalgebra::Vector3};

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
        let pose = |aim: &Aim| Se3 {
            rotation: exp_so3(&log_so3(&aim.rotation)),
            translation: Vector3::zeros(),
        };
        let map = Map {
            focal,
            poses: found.aims.iter().map(|aim| Some(pose(aim))).collect(),
            points: vec![None; self.tracks.len()],
        };
        let tracks = through(&self.tracks, &found.aims, focal);
        let median_px = median_far_error(&map, &tracks).unwrap_or(f64::INFINITY);
        Ok(Some(Zoom {
            found,
            map,
            tracks,
            median_px,
        }))
    }

    /// A rotation and intrinsics per frame.
    pub(super) fn zoomed(&mut self, zoom: Zoom) -> Recovered {
        let Zoom {
            found,
            map,
            tracks,
            median_px,
        } = zoom;
        let first = found.aims[0].focal;
        let base = self.lenses.of(0);
        let base = base.unwrap_or_else(|| Intrinsics::centred(self.width, self.height, first / self.size.scale));
        let lens = |aim: &Aim| Intrinsics {
            fx: base.fx * aim.focal / first,
            fy: base.fy * aim.focal / first,
            ..base
        };
        self.masked = through(&self.masked, &found.aims, map.focal);
        self.tracks = tracks;
        self.lenses = Lenses::Zooming(found.aims.iter().map(lens).collect());
        let note = if found.focal_observed {
            String::new()
        } else {
            self.focal_note()
        };
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
