//! A moving camera: growth from keyframes, then all frames, bundle adjustment and motion in turn.

use super::bundle::{BundleOptions, BundleReport};
use super::growth::{MIN_MATCHES, scan, start_pairs};
use super::known::{FocalSource, Recovered};
use super::map::Map;
use super::motion::classify;
use super::reconstruct::Clip;
use super::rotation::keyframes;
use super::selection::{Selected, select};
use super::{SparseError, stopped};
use crate::reconstruction::{CameraMotion, Motion};

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
        let geometry = &self.geometry;
        let free_focal = self.given_focal().is_none();
        let keys = keyframes(&self.tracks, self.frames, self.size.width, likely_focal, geometry);
        let pairs = start_pairs(&self.tracks, &keys, likely_focal, self.size.width);
        let starts = scan(&self.tracks, &pairs, focals, geometry, self.progress)?;
        let selected = select(
            &self.tracks,
            &keys,
            &starts,
            self.frames,
            free_focal,
            geometry,
            self.progress,
        )?;
        let Some(Selected { mut map, rival_focal }) = selected else {
            let first = starts.iter().max_by_key(|s| s.view.inliers.len());
            return Ok(Err(SparseError::NoStart {
                inliers: first.map_or(0, |s| s.view.inliers.len()),
                matches: first.map_or(0, |s| s.pair.matches),
                needed: MIN_MATCHES,
            }));
        };
        let (motions, report) = self.refine(&mut map, free_focal)?;
        let points = map.points.iter().flatten().count();
        let judged = motions.iter().filter(|m| **m != Motion::Unknown).count();
        let needed = MIN_POINTS.max(judged / 20);
        if points < needed {
            return Ok(Err(SparseError::TooFewPoints {
                points,
                tracks: judged,
                needed,
            }));
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
            self.check_given_focal(&map);
        }
        let sigma = self.judge(&map, &motions, &report, free_focal);
        let sparse = self.finish(map, &motions, CameraMotion::Parallax);
        let focal = if free_focal {
            FocalSource::Estimated { sigma: Some(sigma) }
        } else {
            FocalSource::Given
        };
        Ok(Ok(Recovered { sparse, focal }))
    }

    fn bundle_options(&self, free_focal: bool) -> BundleOptions {
        BundleOptions {
            cauchy_px: self.geometry.cauchy_px,
            iterations: self.geometry.bundle_iterations,
            tolerance: self.geometry.bundle_tolerance,
            free_focal,
            free_poses: true,
        }
    }

    /// Warns when the clip fits another focal length than the given one clearly better.
    fn check_given_focal(&mut self, map: &Map) {
        let (mut held, mut freed) = (map.clone(), map.clone());
        let (with, without) = (
            held.adjust(&self.tracks, &self.bundle_options(false)),
            freed.adjust(&self.tracks, &self.bundle_options(true)),
        );
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
    }

    /// All frames, bundle adjustment and classification in turn.
    fn refine(&mut self, map: &mut Map, free_focal: bool) -> Result<(Vec<Motion>, BundleReport), SparseError> {
        let mut usable = vec![true; self.tracks.len()];
        self.register_all(map)?;
        map.triangulate(&self.tracks, &usable, &self.geometry);
        let rounds = self.config.motion.rounds.max(1);
        let mut motions = Vec::new();
        let mut report = map.adjust(&self.tracks, &self.bundle_options(free_focal));
        for round in 0..rounds {
            stopped(self.progress)?;
            self.progress.update(
                "bundle adjustment",
                round,
                rounds,
                &format!("focal {:.1} px", map.focal / self.size.scale),
            );
            if let Some(typical) = map.median_error(&self.tracks) {
                self.geometry.sharpen(typical);
            }
            motions = classify(map, &self.tracks, &self.config.motion);
            for (u, m) in usable.iter_mut().zip(&motions) {
                *u = *m != Motion::Dynamic;
            }
            map.triangulate(&self.tracks, &usable, &self.geometry);
            self.register_all(map)?;
            report = map.adjust(&self.tracks, &self.bundle_options(free_focal));
        }
        map.triangulate(&self.tracks, &usable, &self.geometry);
        self.progress.update("bundle adjustment", rounds, rounds, "");
        Ok((motions, report))
    }

    /// Places the frames that have no pose yet, nearest to placed ones first.
    fn register_all(&mut self, map: &mut Map) -> Result<(), SparseError> {
        loop {
            stopped(self.progress)?;
            let open: Vec<usize> = (0..self.frames).filter(|&i| map.poses[i].is_none()).collect();
            let mut placed = 0;
            for frame in open {
                let beside = frame.checked_sub(1).is_some_and(|i| map.poses[i].is_some())
                    || map.poses.get(frame + 1).is_some_and(Option::is_some);
                placed += usize::from(beside && map.register(&self.tracks, frame, &self.geometry));
            }
            self.progress.update("frames", map.registered(), self.frames, "");
            if placed == 0 {
                return Ok(());
            }
        }
    }
}
