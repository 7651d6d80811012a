//! A moving camera: a map grown over keyframes from several start pairs, then all frames, bundle
//! adjustment and motion in turn.

use super::bundle::{BundleOptions, BundleReport};
use super::map::{Map, ROUNDS, classify};
use super::priors::{FocalSource, Recovered};
use super::reconstruct::SparseProblem;
use super::rival::Verdict;
use super::rotation::{keyframes, matches, turn};
use super::two_view::{Match, TwoView, relate};
use super::{INLIER_PX, SparseError, stopped};
use crate::classical::{CameraMotion, Motion};
use m4_core::Se3;
use m4_core::advice::{FIELD_OF_VIEW, STATIC_CAMERA};
use rayon::prelude::*;
use std::cmp::Reverse;

/// Fewest points of a reconstruction, whatever the number of tracks; else one in twenty.
pub(super) const MIN_POINTS: usize = 30;
/// Fewest common tracks of a start pair.
const MIN_MATCHES: usize = 40;
/// Fewest points that the start pair must give.
const MIN_START_POINTS: usize = 20;
/// Pairs over which the score of a focal length is averaged.
const SCANNED_PAIRS: usize = 4;
/// Starts that are tried in any case.
const ENOUGH: usize = 3;
/// Focal lengths closer than this (logarithm) are taken for the same.
const SAME_FOCAL: f64 = 0.05;
/// A rival explains at least this share of what the winner explains.
const RIVAL: f64 = 0.9;
/// Bundle adjustment ends when a step lowers the loss by less than this share: before tracks are
/// classified anew, and at the end.
pub(super) const ROUGH: f64 = 1e-4;
pub(super) const FINE: f64 = 1e-6;

/// Two keyframes, `a` before `b`, with enough in common and enough between them.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Pair {
    a: usize,
    b: usize,
    /// Tracks in both.
    matches: usize,
    /// Median parallax, working pixels.
    parallax_px: f64,
}

/// A focal length, working pixels, and a pair related under it.
pub(super) struct Start {
    focal: f64,
    /// Mean score over the scanned pairs, 0 to 1.
    score: f64,
    pair: Pair,
    view: TwoView,
}

impl SparseProblem<'_> {
    /// Poses, focal length and points; [`SparseError::NoAgreement`] where no pair of frames gives a
    /// start that carries.
    pub(super) fn moving(
        &mut self,
        focals: &[f64],
        likely_focal: f64,
    ) -> Result<Recovered, SparseError> {
        let free_focal = self.free_focal();
        let keys = keyframes(
            &self.tracks,
            self.frames,
            self.size.width,
            likely_focal,
            self.limits.keyframe_parallax,
        );
        let starts = self.scan(&self.start_pairs(&keys, likely_focal), focals)?;
        let selected = self.select(&keys, &starts)?;
        stopped(self.progress)?;
        let Some((map, rival_focal)) = selected else {
            let first = starts.iter().max_by_key(|s| s.view.inliers.len());
            let (inliers, matches) =
                first.map_or((0, 0), |s| (s.view.inliers.len(), s.pair.matches));
            if inliers >= MIN_MATCHES && 2 * inliers >= matches {
                return Err(SparseError::NoAgreement(
                    "the camera can be followed through less than half of the clip: too few points of one part are tracked into the \
                     next (fast turns, blur, plain walls); use a part without them (start, end), or supply a capture with poses"
                        .to_owned(),
                ));
            }
            return Err(SparseError::NoAgreement(format!(
                "no two frames agree on a static scene: the best pair has {inliers} of {matches} points on one rigid motion, \
                 {MIN_MATCHES} are needed (do moving objects fill the image?); {FIELD_OF_VIEW}, {STATIC_CAMERA} if \
                 it is, or supply a capture with poses"
            )));
        };
        let first = self.refine(map)?;
        let ((map, motions, report), verdict, warning) = self.static_world(first)?;
        if let Some(bend) = self.bend_beyond(&map)? {
            return self.straightened(bend, focals);
        }
        if let Some(warning) = warning {
            self.warn(warning);
        }
        let points = map.points.iter().flatten().count();
        let tracks = motions.iter().filter(|m| **m != Motion::Unknown).count();
        let needed = MIN_POINTS.max(tracks / 20);
        if points < needed {
            return Err(SparseError::NoAgreement(format!(
                "only {points} of {tracks} tracks fit a static scene after bundle adjustment, {needed} are needed (do moving \
                 objects fill the image?); {FIELD_OF_VIEW}, {STATIC_CAMERA} if it is, or supply a \
                 capture with poses"
            )));
        }
        if let Some(rival) = rival_focal {
            self.warn(format!(
                "fields of view of {:.0} and {:.0} degrees explain the clip almost equally well, the first was taken; \
                 {FIELD_OF_VIEW} if it is known",
                self.fov_deg(map.focal),
                self.fov_deg(rival)
            ));
        }
        if !free_focal {
            self.check_given_focal(&map)?;
        }
        let sigma = self.judge(&map, (&motions, verdict), &report, free_focal);
        let sparse = self.finish(map, &motions, CameraMotion::Parallax);
        let focal = if free_focal {
            FocalSource::Estimated { sigma: Some(sigma) }
        } else {
            FocalSource::Given
        };
        Ok(Recovered {
            sparse,
            focal,
            distortion: self.distortion(),
            tied: verdict == Verdict::Tied,
        })
    }

    /// Pairs of keyframes, best first: much parallax, many tracks in common.
    pub(super) fn start_pairs(&self, keys: &[usize], focal: f64) -> Vec<Pair> {
        let all: Vec<(usize, usize)> = keys
            .iter()
            .enumerate()
            .flat_map(|(i, &a)| keys[i + 1..].iter().map(move |&b| (a, b)))
            .collect();
        let mut pairs: Vec<Pair> = all
            .par_iter()
            .filter_map(|&(a, b)| {
                let matches = matches(&self.tracks, a, b);
                let parallax_px = turn(&matches, focal)?.parallax_px;
                (matches.len() >= MIN_MATCHES).then_some(Pair {
                    a,
                    b,
                    matches: matches.len(),
                    parallax_px,
                })
            })
            .collect();
        // Beyond 8 % of the width more parallax buys nothing and costs tracks.
        let enough_px = 0.08 * self.size.width as f64;
        let worth = |p: &Pair| (p.parallax_px / enough_px).min(1.0) * (p.matches as f64).min(300.0);
        pairs.sort_by(|x, y| {
            worth(y)
                .total_cmp(&worth(x))
                .then((x.a, x.b).cmp(&(y.a, y.b)))
        });
        pairs
    }

    /// For every focal length the mean score over the best few pairs, and those pairs as starts;
    /// best score first.
    pub(super) fn scan(&self, pairs: &[Pair], focals: &[f64]) -> Result<Vec<Start>, SparseError> {
        // Pairs that overlap in time say the same thing twice.
        let mut picked: Vec<(Pair, Vec<Match>)> = Vec::new();
        for pair in pairs {
            let shares = |p: &Pair| {
                (p.a == pair.a && p.b.abs_diff(pair.b) < 3)
                    || (p.b == pair.b && p.a.abs_diff(pair.a) < 3)
            };
            if picked.len() < SCANNED_PAIRS && !picked.iter().any(|(p, _)| shares(p)) {
                picked.push((*pair, matches(&self.tracks, pair.a, pair.b)));
            }
        }
        let mut starts = Vec::new();
        for (done, &focal) in focals.iter().enumerate() {
            stopped(self.progress)?;
            self.progress.update("focal length", done, focals.len(), "");
            let views: Vec<Option<TwoView>> = picked
                .par_iter()
                .enumerate()
                .map(|(i, (_, matches))| relate(matches, focal, self.config.seed, i as u64))
                .collect();
            let score =
                views.iter().flatten().map(|v| v.score).sum::<f64>() / picked.len().max(1) as f64;
            for ((pair, _), view) in picked.iter().zip(views) {
                starts.extend(view.map(|view| Start {
                    focal,
                    score,
                    pair: *pair,
                    view,
                }));
            }
        }
        self.progress
            .update("focal length", focals.len(), focals.len(), "");
        // Stable: the pairs of a focal length stay in order.
        starts.sort_by(|a, b| {
            b.score
                .total_cmp(&a.score)
                .then(a.focal.total_cmp(&b.focal))
        });
        Ok(starts)
    }

    /// A map grown over the keyframes; frames that cannot be placed stay without a pose. `None`
    /// when the start pair gives too few points.
    fn grow(&self, keys: &[usize], start: &Start) -> Result<Option<Map>, SparseError> {
        let (tracks, free_focal) = (&self.tracks, self.free_focal());
        let triangulate = |map: &mut Map| map.triangulate(tracks, &[], &self.limits);
        let adjust = |map: &mut Map, iterations: usize, free_focal: bool| {
            let options = BundleOptions {
                cauchy_px: self.limits.cauchy_px,
                iterations,
                tolerance: ROUGH,
                free_focal,
                free_bend: false,
            };
            map.adjust(tracks, &options, self.progress);
        };
        let mut map = Map::new(start.focal, vec![None; self.frames], tracks);
        map.poses[start.pair.a] = Some(Se3::identity());
        map.poses[start.pair.b] = Some(start.view.motion);
        triangulate(&mut map);
        if map.points.iter().flatten().count() < MIN_START_POINTS {
            return Ok(None);
        }
        adjust(&mut map, 10, false);
        let mut adjusted_at = 2;
        let mut failed: Vec<usize> = Vec::new();
        loop {
            stopped(self.progress)?;
            let open = keys
                .iter()
                .copied()
                .filter(|&k| map.poses[k].is_none() && !failed.contains(&k));
            let counted = open.map(|k| (map.sightings(tracks, k).len(), k));
            let Some((_, next)) = counted.max_by_key(|&(n, k)| (n, Reverse(k))) else {
                break;
            };
            if !map.register(tracks, next) {
                failed.push(next);
                continue;
            }
            // A new camera brings new points, which may place the ones that failed.
            failed.clear();
            triangulate(&mut map);
            let count = map.registered();
            if count <= 5 || 6 * count >= 7 * adjusted_at {
                adjusted_at = count;
                adjust(&mut map, 8, free_focal && count >= 4);
                triangulate(&mut map);
            }
            self.progress
                .update("keyframes", count.min(keys.len()), keys.len(), "");
        }
        for _ in 0..2 {
            let free_focal = free_focal && map.registered() >= 3;
            adjust(&mut map, 15, free_focal);
            triangulate(&mut map);
        }
        Ok(Some(map))
    }

    /// Grows a map from each picked start; the one that explains the tracks best, and the focal
    /// length of another that explains nearly as much. `None` when no start carries over at least
    /// half of the keyframes.
    ///
    /// A wrong focal length shows in residuals that are small still, yet larger: what counts as
    /// explained is measured against three times the least median residual among the maps.
    pub(super) fn select(
        &self,
        keys: &[usize],
        starts: &[Start],
    ) -> Result<Option<(Map, Option<f64>)>, SparseError> {
        let (tracks, free_focal) = (&self.tracks, self.free_focal());
        let mut maps: Vec<Map> = Vec::new();
        for (tried, start) in order(starts).into_iter().enumerate() {
            if tried >= ENOUGH && !maps.is_empty() {
                break;
            }
            let grown = self.grow(keys, start)?;
            stopped(self.progress)?;
            let placed = |map: &Map| keys.iter().filter(|&&i| map.poses[i].is_some()).count();
            let Some(map) = grown.filter(|map| 2 * placed(map) >= keys.len()) else {
                continue;
            };
            // Two starts that end in one place need no third.
            let agree = maps
                .iter()
                .any(|m| (m.focal / map.focal).ln().abs() < 0.1 * SAME_FOCAL);
            maps.push(map);
            if agree || !free_focal {
                break;
            }
        }
        let medians = maps.iter().filter_map(|m| m.median_error(tracks));
        let least = medians.fold(f64::INFINITY, f64::min);
        if maps.len() > 1 {
            // With the narrow loss, maps that only stopped short of one another meet.
            let mut narrow = self.limits;
            narrow.sharpen(least);
            for map in &mut maps {
                map.adjust(
                    tracks,
                    &BundleOptions::whole(&narrow, FINE, free_focal),
                    self.progress,
                );
            }
            stopped(self.progress)?;
        }
        let scale = (3.0 * least).clamp(0.1, INLIER_PX);
        let mut scored: Vec<(f64, Map)> = maps
            .into_iter()
            .map(|m| (m.explained(tracks, scale), m))
            .collect();
        scored.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut scored = scored.into_iter();
        Ok(scored.next().map(|(explained, map)| {
            let rival = scored.find(|(e, m)| {
                *e > RIVAL * explained && (m.focal / map.focal).ln().abs() > SAME_FOCAL
            });
            (map, rival.map(|(_, m)| m.focal))
        }))
    }

    /// Warns when the clip fits another focal length than the given one clearly better.
    fn check_given_focal(&mut self, map: &Map) -> Result<(), SparseError> {
        let (mut held, mut freed) = (map.clone(), map.clone());
        let (with, without) = (
            self.adjust(&mut held, false, FINE)?,
            self.adjust(&mut freed, true, FINE)?,
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
        Ok(())
    }

    /// All frames, bundle adjustment and classification in turn; limits get as sharp as the errors
    /// of the map allow.
    pub(super) fn refine(
        &mut self,
        mut map: Map,
    ) -> Result<(Map, Vec<Motion>, BundleReport), SparseError> {
        let free_focal = self.free_focal();
        let mut motions = Vec::new();
        self.register_all(&mut map)?;
        map.triangulate(&self.tracks, &motions, &self.limits);
        let mut report = self.adjust(&mut map, free_focal, ROUGH)?;
        self.close_loops(&mut map)?;
        for round in 0..ROUNDS {
            let note = format!("focal {:.1} px", map.focal / self.size.scale);
            self.progress
                .update("bundle adjustment", round, ROUNDS, &note);
            if let Some(typical) = map.median_error(&self.tracks) {
                self.limits.sharpen(typical);
            }
            motions = classify(&map, &self.tracks);
            map.triangulate(&self.tracks, &motions, &self.limits);
            self.register_all(&mut map)?;
            map.weigh(&self.tracks);
            let tolerance = if round + 1 < ROUNDS { ROUGH } else { FINE };
            report = self.adjust(&mut map, free_focal, tolerance)?;
        }
        map.triangulate(&self.tracks, &motions, &self.limits);
        self.progress
            .update("bundle adjustment", ROUNDS, ROUNDS, "");
        Ok((map, motions, report))
    }

    /// Bundle adjustment of all poses and points, an error where it was interrupted.
    fn adjust(
        &self,
        map: &mut Map,
        free_focal: bool,
        tolerance: f64,
    ) -> Result<BundleReport, SparseError> {
        let options = BundleOptions::whole(&self.limits, tolerance, free_focal);
        let report = map.adjust(&self.tracks, &options, self.progress);
        stopped(self.progress).map(|()| report)
    }

    /// Places the frames that have no pose yet, nearest to placed ones first.
    fn register_all(&self, map: &mut Map) -> Result<(), SparseError> {
        loop {
            let open: Vec<usize> = (0..self.frames)
                .filter(|&i| map.poses[i].is_none())
                .collect();
            let mut placed = 0;
            for frame in open {
                stopped(self.progress)?;
                let beside = frame.checked_sub(1).is_some_and(|i| map.poses[i].is_some())
                    || map.poses.get(frame + 1).is_some_and(Option::is_some);
                placed += usize::from(beside && map.register(&self.tracks, frame));
            }
            self.progress
                .update("frames", map.registered(), self.frames, "");
            if placed == 0 {
                return Ok(());
            }
        }
    }
}

/// The best start, two others whose focal lengths differ from those taken by a third, then all
/// other pairs of the best focal length.
fn order(starts: &[Start]) -> Vec<&Start> {
    let mut picked: Vec<&Start> = Vec::new();
    for start in starts {
        let apart = picked
            .iter()
            .all(|p| (p.focal / start.focal).ln().abs() > 0.28);
        if picked.len() < ENOUGH && apart {
            picked.push(start);
        }
    }
    if let Some(best) = starts.first() {
        picked.extend(
            starts
                .iter()
                .filter(|s| s.focal == best.focal && s.pair != best.pair),
        );
    }
    picked
}
