//! Which tracks move, judged by how badly a resting point explains them.

use super::map::Map;
use super::tracking::RawTrack;
use super::triangulate::triangulate;
use crate::classical::reconstruction::Motion;
use m4_core::{median, nalgebra::Vector3};
use rayon::prelude::*;

/// Median of the length of a residual whose two components have standard deviation 1 (Rayleigh).
pub(super) const RAYLEIGH_MEDIAN: f64 = 1.177_41;
/// Residuals above this many robust standard deviations disagree. 3: docs/spec/front-end.md 7.1.
const DEVIATIONS: f64 = 3.0;
/// ... if they are also above this, working pixels. 1: docs/spec/front-end.md 7.1.
const MIN_RESIDUAL_PX: f64 = 1.0;
/// A track is dynamic when at least this share of its observations disagrees. 0.3: docs/spec/front-end.md 7.1.
const SHARE: f64 = 0.3;
/// Tracks with fewer observations are not judged. 3: the first number with more than one equation to spare.
const MIN_OBSERVATIONS: usize = 3;
/// How often classification and bundle adjustment alternate. 2: docs/spec/front-end.md 7.1.
pub(super) const ROUNDS: usize = 2;

/// Judges every track: the best resting point is fitted to all its observations, also to those of
/// tracks that the map gave up on; where rays do not meet, a point at infinity stands in.
///
/// What counts as disagreement follows the errors of the map's points, or, in a map without points,
/// those of all tracks.
pub(crate) fn classify(map: &Map, tracks: &[RawTrack]) -> Vec<Motion> {
    let limit_for = |typical: f64| (DEVIATIONS * typical / RAYLEIGH_MEDIAN).max(MIN_RESIDUAL_PX);
    let limit = match map.median_error(tracks) {
        Some(typical) => limit_for(typical),
        None => limit_for(median_far_error(map, tracks).unwrap_or(0.0)),
    };
    tracks
        .par_iter()
        .map(|track| {
            let errors = resting_errors(map, track, limit);
            let seen = errors.len();
            let disagree = errors.iter().filter(|e| **e > limit).count();
            if seen < MIN_OBSERVATIONS {
                Motion::Unknown
            } else if disagree as f64 >= SHARE * seen as f64 {
                Motion::Dynamic
            } else {
                Motion::Static
            }
        })
        .collect()
}

/// Median over all tracks of the median error of a point at infinity.
pub(crate) fn median_far_error(map: &Map, tracks: &[RawTrack]) -> Option<f64> {
    let mut all: Vec<f64> = tracks
        .par_iter()
        .filter_map(|track| median(&mut map.errors(track, &far_point(map, track)?)))
        .collect();
    median(&mut all)
}

/// Errors of the resting point that fits best.
fn resting_errors(map: &Map, track: &RawTrack, limit: f64) -> Vec<f64> {
    let views = map.views(track);
    let above = |errors: &[f64]| errors.iter().filter(|e| **e > limit).count();
    let near = triangulate(&views, map.focal, limit).map(|t| map.errors(track, &t.point));
    let far = far_point(map, track).map(|x| map.errors(track, &x)).unwrap_or_default();
    match near {
        Some(near) if above(&near) <= above(&far) || far.is_empty() => near,
        _ => far,
    }
}

/// A point far away in the mean direction of the track's rays.
fn far_point(map: &Map, track: &RawTrack) -> Option<Vector3<f64>> {
    let views = map.views(track);
    let ray = |at: &[f64; 2]| Vector3::new(at[0], at[1], map.focal).normalize();
    let sum: Vector3<f64> = views.iter().map(|(pose, at)| pose.rotation.tr_mul(&ray(at))).sum();
    let extent = map
        .poses
        .iter()
        .flatten()
        .map(|p| p.translation.norm())
        .fold(1.0, f64::max);
    (sum.norm() > 0.0).then(|| sum.normalize() * 1e5 * extent)
}
