//! Lenses that bend straight lines, as of action cameras: one coefficient beside the focal length,
//! where the clip shows that it is needed.
//!
//! Cameras are estimated as of a pinhole first. If bundle adjustment with a free coefficient then
//! explains the tracks clearly better, the distortion is taken out of the tracks and the cameras
//! are estimated again, until nothing is left of it.

use super::bundle::BundleOptions;
use super::growth::FINE;
use super::lens::Bend;
use super::map::Map;
use super::priors::Recovered;
use super::reconstruct::SparseProblem;
use super::rotation::Limits;
use super::tracking::RawTrack;
use super::{SparseError, stopped};
use serde::{Deserialize, Serialize};

/// A lens is bent if that lowers the mean loss to less than this share. On ten clips without
/// distortion, or with little, it stayed above 0.99; distortion of 27 pixels at the corners lowers
/// it to 0.17.
const EVIDENCE: f64 = 0.9;
/// ... and the coefficient is this many standard deviations from 0.
const DEVIATIONS: f64 = 6.0;
/// Distortion less than this share of the image width at the corners changes nothing. 0.001: half a
/// pixel of 480.
const LEAST: f64 = 0.001;
/// Most estimations with distortion taken out; three are usual.
const ROUNDS: usize = 5;
/// Coefficients beyond this leave nothing of the corners.
const MOST: f64 = 0.85;

/// How a lens bends rays: a point at distance `u` from the image centre without distortion appears
/// at `d`, `u = d / (1 + coefficient (d / r)^2)`, `r` half of the image's diagonal (division model,
/// Fitzgibbon 2001).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RadialDistortion {
    /// Below 0: barrel; no unit.
    pub coefficient: f64,
    /// Focal length, pixels of the input images: the scale in the centre, which distortion keeps.
    pub focal_px: f64,
}

/// What was taken out of the tracks.
pub(super) struct Straight {
    bend: Bend,
    /// Tracks and those in masks as they were.
    tracks: [Vec<RawTrack>; 2],
    /// Limits when the distortion showed.
    limits: Limits,
    rounds: usize,
    /// Focal length of the last map, working pixels.
    focal: f64,
}

impl SparseProblem<'_> {
    /// The distortion that is left in `map`, `None` where it is too little to matter.
    pub(super) fn bend_beyond(&mut self, map: &Map) -> Result<Option<Bend>, SparseError> {
        if self.config.pinhole || self.config.intrinsics.is_some() {
            return Ok(None);
        }
        let free_focal = self.free_focal();
        let straight = BundleOptions::whole(&self.limits, FINE, free_focal);
        let bent = BundleOptions {
            free_bend: true,
            ..straight
        };
        let (mut held, mut trial) = (map.clone(), map.clone());
        trial.bend = Bend {
            coefficient: 0.0,
            radius_px: 0.5 * (self.size.width as f64).hypot(self.size.height as f64),
        };
        let without = held.adjust(&self.tracks, &straight, self.progress);
        let with = trial.adjust(&self.tracks, &bent, self.progress);
        stopped(self.progress)?;
        let typical_px = map.median_error(&self.tracks).unwrap_or(0.0).max(0.1);
        let (bend, sigma) = (trial.bend, with.bend_sigma * typical_px);
        let corner = bend.coefficient.abs() * bend.radius_px / self.size.width as f64;
        if let Some(straight) = &mut self.straight {
            straight.focal = map.focal;
            return Ok((corner > LEAST && straight.rounds < ROUNDS).then_some(bend));
        }
        let shown = with.cost < EVIDENCE * without.cost
            && bend.coefficient.abs() > DEVIATIONS * sigma
            && corner > LEAST;
        Ok(shown.then_some(bend))
    }

    /// Cameras once the distortion `bend`, beyond that of earlier rounds, is taken out; where that
    /// fails the tracks are as they were.
    pub(super) fn straightened(
        &mut self,
        bend: Bend,
        focals: &[f64],
    ) -> Result<Recovered, SparseError> {
        let straight = self.straight.get_or_insert_with(|| Straight {
            bend: Bend {
                coefficient: 0.0,
                ..bend
            },
            tracks: [self.tracks.clone(), self.masked.clone()],
            limits: self.limits,
            rounds: 0,
            focal: 0.0,
        });
        straight.rounds += 1;
        let sum = straight.bend.coefficient + bend.coefficient;
        straight.bend.coefficient = sum.clamp(-MOST, MOST);
        let bend = straight.bend;
        self.limits = straight.limits;
        for (tracks, before) in [&mut self.tracks, &mut self.masked]
            .into_iter()
            .zip(&straight.tracks)
        {
            tracks.clone_from(before);
            for (_, at) in tracks.iter_mut().flat_map(RawTrack::positions_mut) {
                *at = bend.pinhole(*at);
            }
        }
        self.progress
            .update("lens", 0, 1, &format!("distortion {:.4}", bend.coefficient));
        let recovered = self.moving(focals, self.default_focal());
        if recovered.is_err()
            && let Some(straight) = self.straight.take()
        {
            [self.tracks, self.masked] = straight.tracks;
        }
        recovered
    }

    /// What was taken out of the tracks, for the user's images.
    pub(super) fn distortion(&self) -> Option<RadialDistortion> {
        self.straight.as_ref().map(|straight| RadialDistortion {
            coefficient: straight.bend.coefficient,
            focal_px: straight.focal / self.size.scale,
        })
    }
}
