//! A moving camera: growth from keyframes, then all frames, bundle adjustment and motion in turn.

use super::bundle::{BundleOptions, BundleReport};
use super::growth::{MIN_MATCHES, Selected, scan, select, start_pairs};
use super::map::{Map, ROUNDS, classify};
use super::priors::{FocalSource, Recovered};
use super::reconstruct::Clip;
use super::rotation::{Limits, keyframes};
use super::{SparseError, stopped};
use crate::classical::reconstruction::{CameraMotion, Motion};

/// Steps of the final bundle adjustments.
const BUNDLE_ITERATIONS: usize = 30;
/// Bundle adjustment ends when a step lowers the loss by less than this share.
const BUNDLE_TOLERANCE: f64 = 1e-6;
/// Fewest points of a reconstruction, whatever the number of tracks; else one in twenty.
pub(super) const MIN_POINTS: usize = 30;

impl Clip<'_> {
    /// Poses, focal length and points; the inner error where no pair of frames gives a start that
    /// carries.
    ///
    /// # Errors
    ///
    /// [`SparseError::Cancelled`].
    pub(super) fn moving(
        &mut self,
        focals: &[f64],
        likely_focal: f64,
    ) -> Result<Result<Recovered, SparseError>, SparseError> {
        let limits = &self.limits;
        let free_focal = self.given_focal().is_none();
        let (tracks, frames, width) = (&self.tracks, self.frames, self.size.width);
        let keys = keyframes(tracks, frames, width, likely_focal, limits.keyframe_parallax);
        let pairs = start_pairs(tracks, &keys, likely_focal, width);
        let starts = scan(tracks, &pairs, focals, self.config.seed, self.progress)?;
        let selected = select(tracks, &keys, &starts, frames, free_focal, limits, self.progress)?;
        stopped(self.progress)?;
        let Some(Selected { map, rival_focal }) = selected else {
            let first = starts.iter().max_by_key(|s| s.view.inliers.len());
            return Ok(Err(SparseError::NoStart {
                inliers: first.map_or(0, |s| s.view.inliers.len()),
                matches: first.map_or(0, |s| s.pair.matches),
                needed: MIN_MATCHES,
            }));
        };
        let Refined { map, limits, motions, report } = self.refine(map, free_focal)?;
        self.limits = limits;
        let points = map.points.iter().flatten().count();
        let judged = motions.iter().filter(|m| **m != Motion::Unknown).count();
        let needed = MIN_POINTS.max(judged / 20);
        if points < needed {
            return Ok(Err(SparseError::TooFewPoints { points, tracks: judged, needed }));
        }
        if let Some(rival) = rival_focal {
            self.warn(format!(
                "fields of view of {:.0} and {:.0} degrees explain the clip almost equally well, the first was taken; \
                 pass --fov if the field of view is known",
                self.fov_deg(map.focal),
                self.fov_deg(rival)
            ));
        }
        if !free_focal {
            self.check_given_focal(&map)?;
        }
        let sigma = self.judge(&map, &motions, &report, free_focal);
        let sparse = self.finish(map, &motions, CameraMotion::Parallax);
        let focal = if free_focal { FocalSource::Estimated { sigma: Some(sigma) } } else { FocalSource::Given };
        Ok(Ok(Recovered { sparse, focal }))
    }

    /// Warns when the clip fits another focal length than the given one clearly better.
    fn check_given_focal(&mut self, map: &Map) -> Result<(), SparseError> {
        let adjusted = |free_focal| {
            let mut map = map.clone();
            let report = map.adjust(&self.tracks, &bundle_options(&self.limits, free_focal), self.progress);
            stopped(self.progress).map(|()| (map, report))
        };
        let ((_, with), (freed, without)) = (adjusted(false)?, adjusted(true)?);
        if (freed.focal / map.focal).ln().abs() > 0.1 && without.cost < 0.8 * with.cost {
            self.warn(format!(
                "the given field of view of {:.1} degrees was kept, but the clip fits one of {:.1} degrees better (mean \
                 loss {:.3} instead of {:.3} px^2)",
                self.fov_deg(map.focal),
                self.fov_deg(freed.focal),
                without.cost,
                with.cost
            ));
        }
        Ok(())
    }

    /// All frames, bundle adjustment and classification in turn.
    fn refine(&self, map: Map, free_focal: bool) -> Result<Refined, SparseError> {
        let usable = vec![true; self.tracks.len()];
        let mut refined = self.adjusted(map, self.limits, Vec::new(), &usable, free_focal, Order::FramesFirst)?;
        for round in 0..ROUNDS {
            self.progress.update(
                "bundle adjustment",
                round,
                ROUNDS,
                &format!("focal {:.1} px", refined.map.focal / self.size.scale),
            );
            let Refined { map, mut limits, .. } = refined;
            if let Some(typical) = map.median_error(&self.tracks) {
                limits.sharpen(typical);
            }
            let motions = classify(&map, &self.tracks);
            let usable = usable_by(&motions);
            refined = self.adjusted(map, limits, motions, &usable, free_focal, Order::PointsFirst)?;
        }
        let usable = usable_by(&refined.motions);
        refined.map.triangulate(&self.tracks, &usable, &refined.limits);
        self.progress.update("bundle adjustment", ROUNDS, ROUNDS, "");
        Ok(refined)
    }

    /// Points of usable tracks, frames that had no pose, and all of them adjusted.
    fn adjusted(
        &self,
        mut map: Map,
        limits: Limits,
        motions: Vec<Motion>,
        usable: &[bool],
        free_focal: bool,
        order: Order,
    ) -> Result<Refined, SparseError> {
        match order {
            Order::FramesFirst => {
                self.register_all(&mut map)?;
                map.triangulate(&self.tracks, usable, &limits);
            }
            Order::PointsFirst => {
                map.triangulate(&self.tracks, usable, &limits);
                self.register_all(&mut map)?;
            }
        }
        let report = map.adjust(&self.tracks, &bundle_options(&limits, free_focal), self.progress);
        // an adjustment that was told to stop is not finished
        stopped(self.progress)?;
        Ok(Refined { map, limits, motions, report })
    }

    /// Places the frames that have no pose yet, nearest to placed ones first.
    fn register_all(&self, map: &mut Map) -> Result<(), SparseError> {
        loop {
            let open: Vec<usize> = (0..self.frames).filter(|&i| map.poses[i].is_none()).collect();
            let mut placed = 0;
            for frame in open {
                stopped(self.progress)?;
                let beside = frame.checked_sub(1).is_some_and(|i| map.poses[i].is_some())
                    || map.poses.get(frame + 1).is_some_and(Option::is_some);
                placed += usize::from(beside && map.register(&self.tracks, frame));
            }
            self.progress.update("frames", map.registered(), self.frames, "");
            if placed == 0 {
                return Ok(());
            }
        }
    }
}

/// A map of all frames while it is refined.
struct Refined {
    map: Map,
    /// As sharp as the errors of the map allow.
    limits: Limits,
    /// By track; empty before they were judged.
    motions: Vec<Motion>,
    report: BundleReport,
}

/// Whether frames are placed before points are triangulated anew.
enum Order {
    FramesFirst,
    PointsFirst,
}

fn usable_by(motions: &[Motion]) -> Vec<bool> {
    motions.iter().map(|m| *m != Motion::Dynamic).collect()
}

/// How a map of all frames is adjusted.
pub(super) fn bundle_options(limits: &Limits, free_focal: bool) -> BundleOptions {
    BundleOptions {
        cauchy_px: limits.cauchy_px,
        iterations: BUNDLE_ITERATIONS,
        tolerance: BUNDLE_TOLERANCE,
        free_focal,
        free_poses: true,
    }
}
