//! A moving camera: growth from keyframes, then all frames, bundle adjustment and motion in turn.

use super::bundle::{BundleOptions, BundleReport};
use super::config::GeometryConfig;
use super::growth::{MIN_MATCHES, Start, grow, scan, start_pairs};
use super::map::Map;
use super::motion::classify;
use super::reconstruct::Clip;
use super::rotation::keyframes;
use super::{SparseError, stopped};
use crate::reconstruction::{CameraMotion, Motion, SparseReconstruction};

/// Fewest points of a reconstruction, whatever the number of tracks; else one in twenty.
const MIN_POINTS: usize = 30;

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
    ) -> Result<Result<SparseReconstruction, SparseError>, SparseError> {
        let geometry = &self.geometry;
        let free_focal = self.given_focal().is_none();
        let keys = keyframes(&self.tracks, self.frames, self.size.width, likely_focal, geometry);
        let pairs = start_pairs(&self.tracks, &keys, likely_focal, self.size.width);
        let starts = scan(&self.tracks, &pairs, focals, geometry, self.progress)?;
        let usable = vec![true; self.tracks.len()];
        let mut best: Option<(f64, Map)> = None;
        for start in picked_starts(&starts) {
            let grown = grow(
                &self.tracks,
                &usable,
                &keys,
                start,
                self.frames,
                free_focal,
                geometry,
                self.progress,
            )?;
            let Some(map) = grown else { continue };
            let explained = map.explained(&self.tracks, geometry.inlier_px);
            if best.as_ref().is_none_or(|(e, _)| explained > *e) {
                best = Some((explained, map));
            }
        }
        let Some((_, mut map)) = best.filter(|(_, map)| 2 * map.registered_among(&keys) >= keys.len()) else {
            let first = starts.first();
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
        self.judge(&map, &motions, &report, free_focal);
        Ok(Ok(self.finish(map, motions, CameraMotion::Parallax)))
    }

    /// All frames, bundle adjustment and classification in turn.
    fn refine(&mut self, map: &mut Map, free_focal: bool) -> Result<(Vec<Motion>, BundleReport), SparseError> {
        let GeometryConfig {
            cauchy_px,
            bundle_iterations,
            bundle_tolerance,
            ..
        } = self.config.geometry;
        let mut usable = vec![true; self.tracks.len()];
        self.register_all(map)?;
        map.triangulate(&self.tracks, &usable, &self.geometry);
        let options = BundleOptions {
            cauchy_px,
            iterations: bundle_iterations,
            tolerance: bundle_tolerance,
            free_focal,
            free_poses: true,
        };
        let rounds = self.config.motion.rounds.max(1);
        let mut motions = Vec::new();
        let mut report = map.adjust(&self.tracks, &options);
        for round in 0..rounds {
            stopped(self.progress)?;
            self.progress.update(
                "bundle adjustment",
                round,
                rounds,
                &format!("focal {:.1} px", map.focal / self.size.scale),
            );
            motions = classify(map, &self.tracks, &self.config.motion);
            for (u, m) in usable.iter_mut().zip(&motions) {
                *u = *m != Motion::Dynamic;
            }
            map.triangulate(&self.tracks, &usable, &self.geometry);
            self.register_all(map)?;
            report = map.adjust(&self.tracks, &options);
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

/// The best start and up to two others whose focal lengths differ from those taken by a third.
fn picked_starts(starts: &[Start]) -> Vec<&Start> {
    let mut picked: Vec<&Start> = Vec::new();
    for start in starts {
        let apart = picked.iter().all(|p| (p.focal / start.focal).ln().abs() > 0.28);
        if picked.len() < 3 && apart {
            picked.push(start);
        }
    }
    picked
}
