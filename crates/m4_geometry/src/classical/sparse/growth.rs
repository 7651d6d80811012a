//! From keyframes to a map: a start pair, then one keyframe after another, from several starts; the best map goes on.

use super::adjustment::bundle_options;
use super::bundle::BundleOptions;
use super::map::Map;
use super::rotation::{Limits, matches, turn};
use super::tracking::RawTrack;
use super::two_view::{TwoView, relate};
use super::{INLIER_PX, SparseError, stopped};
use m4_core::{Progress, Se3};
use rayon::prelude::*;

/// Two keyframes with enough in common and enough between them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pair {
    /// Earlier frame.
    pub a: usize,
    /// Later frame.
    pub b: usize,
    /// Tracks in both.
    pub matches: usize,
    /// Median parallax, working pixels.
    pub parallax_px: f64,
}

/// Pairs of keyframes, best first: much parallax, many tracks in common.
pub(crate) fn start_pairs(tracks: &[RawTrack], keys: &[usize], focal: f64, width: usize) -> Vec<Pair> {
    let all: Vec<(usize, usize)> =
        keys.iter().enumerate().flat_map(|(i, &a)| keys[i + 1..].iter().map(move |&b| (a, b))).collect();
    let mut pairs: Vec<Pair> = all
        .par_iter()
        .filter_map(|&(a, b)| {
            let found = matches(tracks, a, b);
            let parallax_px = turn(&found, focal)?.parallax_px;
            (found.len() >= MIN_MATCHES).then_some(Pair { a, b, matches: found.len(), parallax_px })
        })
        .collect();
    // Beyond 8 % of the width more parallax buys nothing and costs tracks.
    let worth = |p: &Pair| (p.parallax_px / (0.08 * width as f64)).min(1.0) * (p.matches as f64).min(300.0);
    pairs.sort_by(|x, y| worth(y).total_cmp(&worth(x)).then((x.a, x.b).cmp(&(y.a, y.b))));
    pairs
}

/// Fewest common tracks of a start pair.
pub(crate) const MIN_MATCHES: usize = 40;

/// A start: a focal length and a pair related under it.
#[derive(Debug, Clone)]
pub(crate) struct Start {
    /// Working pixels.
    pub focal: f64,
    /// Mean score over the scanned pairs, 0 to 1.
    pub score: f64,
    /// The frames.
    pub pair: Pair,
    /// How they relate.
    pub view: TwoView,
}

/// For every focal length the mean score over the best few pairs, and those pairs as starts; focal
/// lengths with the best score first.
pub(crate) fn scan(
    tracks: &[RawTrack],
    pairs: &[Pair],
    focals: &[f64],
    seed: u64,
    progress: &dyn Progress,
) -> Result<Vec<Start>, SparseError> {
    // Pairs that overlap in time say the same thing twice.
    let mut picked: Vec<(Pair, Vec<super::two_view::Match>)> = Vec::new();
    for pair in pairs {
        let shares =
            |p: &Pair| (p.a == pair.a && p.b.abs_diff(pair.b) < 3) || (p.b == pair.b && p.a.abs_diff(pair.a) < 3);
        if picked.len() < SCANNED_PAIRS && !picked.iter().any(|(p, _)| shares(p)) {
            picked.push((*pair, matches(tracks, pair.a, pair.b)));
        }
    }
    let mut starts = Vec::new();
    for (done, &focal) in focals.iter().enumerate() {
        stopped(progress)?;
        progress.update("focal length", done, focals.len(), "");
        let views: Vec<Option<TwoView>> = picked
            .par_iter()
            .enumerate()
            .map(|(i, (_, found))| relate(found, focal, INLIER_PX, TWO_VIEW_SAMPLES, seed, i as u64))
            .collect();
        let score = views.iter().flatten().map(|v| v.score).sum::<f64>() / picked.len().max(1) as f64;
        for ((pair, _), view) in picked.iter().zip(views) {
            starts.extend(view.map(|view| Start { focal, score, pair: *pair, view }));
        }
    }
    progress.update("focal length", focals.len(), focals.len(), "");
    // Stable: the pairs of a focal length stay in order.
    starts.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.focal.total_cmp(&b.focal)));
    Ok(starts)
}

/// Random samples of five tracks per pair and focal length.
const TWO_VIEW_SAMPLES: usize = 150;

/// Pairs over which the score of a focal length is averaged.
const SCANNED_PAIRS: usize = 4;

/// Grows a map over the keyframes; frames that cannot be placed stay without a pose. `None` when the
/// start pair gives fewer than 20 points.
pub(crate) fn grow(
    tracks: &[RawTrack],
    usable: &[bool],
    keys: &[usize],
    start: &Start,
    frames: usize,
    free_focal: bool,
    limits: &Limits,
    progress: &dyn Progress,
) -> Result<Option<Map>, SparseError> {
    let mut map = Map { focal: start.focal, poses: vec![None; frames], points: vec![None; tracks.len()] };
    map.poses[start.pair.a] = Some(Se3::identity());
    map.poses[start.pair.b] = Some(start.view.motion);
    map.triangulate(tracks, usable, limits);
    if map.points.iter().flatten().count() < 20 {
        return Ok(None);
    }
    let options = |iterations: usize, free_focal: bool| BundleOptions {
        cauchy_px: limits.cauchy_px,
        iterations,
        tolerance: 1e-4,
        free_focal,
        free_poses: true,
    };
    map.adjust(tracks, &options(10, false), progress);
    let mut adjusted_at = 2;
    let mut failed: Vec<usize> = Vec::new();
    loop {
        stopped(progress)?;
        let open = keys.iter().copied().filter(|&k| map.poses[k].is_none() && !failed.contains(&k));
        let counted = open.map(|k| (map.sightings(tracks, k).len(), k));
        let Some((_, next)) = counted.max_by_key(|&(n, k)| (n, std::cmp::Reverse(k))) else {
            break;
        };
        if !map.register(tracks, next) {
            failed.push(next);
            continue;
        }
        // A new camera brings new points, which may place the ones that failed.
        failed.clear();
        map.triangulate(tracks, usable, limits);
        let count = map.registered();
        if count <= 5 || 6 * count >= 7 * adjusted_at {
            adjusted_at = count;
            map.adjust(tracks, &options(8, free_focal && count >= 4), progress);
            map.triangulate(tracks, usable, limits);
        }
        progress.update("keyframes", count.min(keys.len()), keys.len(), "");
    }
    for _ in 0..2 {
        map.adjust(tracks, &options(15, free_focal && map.registered() >= 3), progress);
        map.triangulate(tracks, usable, limits);
    }
    Ok(Some(map))
}

/// The map that explains the tracks best.
#[derive(Debug, Clone)]
pub(crate) struct Selected {
    /// The winner.
    pub map: Map,
    /// Focal length of another map that explains nearly as much, working pixels.
    pub rival_focal: Option<f64>,
}

/// Focal lengths closer than this (logarithm) are taken for the same.
const SAME_FOCAL: f64 = 0.05;

/// A rival explains at least this share of what the winner explains.
const RIVAL: f64 = 0.9;

/// Grows a map from each picked start and keeps the one that explains the tracks best; `None` when no
/// start carries over at least half of the keyframes.
///
/// A wrong focal length shows in residuals that are small still, yet larger: what counts as explained
/// is measured against three times the least median residual among the maps.
pub(crate) fn select(
    tracks: &[RawTrack],
    keys: &[usize],
    starts: &[Start],
    frames: usize,
    free_focal: bool,
    limits: &Limits,
    progress: &dyn Progress,
) -> Result<Option<Selected>, SparseError> {
    let usable = vec![true; tracks.len()];
    let mut maps: Vec<Map> = Vec::new();
    for (tried, start) in order(starts).into_iter().enumerate() {
        if tried >= ENOUGH && !maps.is_empty() {
            break;
        }
        let grown = grow(tracks, &usable, keys, start, frames, free_focal, limits, progress)?;
        stopped(progress)?;
        let Some(map) = grown.filter(|m| 2 * m.registered_among(keys) >= keys.len()) else {
            continue;
        };
        // Two starts that end in one place need no third.
        let agree = maps.iter().any(|m| (m.focal / map.focal).ln().abs() < 0.1 * SAME_FOCAL);
        maps.push(map);
        if agree || !free_focal {
            break;
        }
    }
    let medians = maps.iter().filter_map(|m| m.median_error(tracks));
    let least = medians.fold(f64::INFINITY, f64::min);
    if maps.len() > 1 {
        polish(&mut maps, tracks, least, free_focal, limits, progress);
        stopped(progress)?;
    }
    let scale = (3.0 * least).clamp(0.1, INLIER_PX);
    let mut scored: Vec<(f64, Map)> = maps.into_iter().map(|m| (m.explained(tracks, scale), m)).collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut scored = scored.into_iter();
    Ok(scored.next().map(|(explained, map)| {
        let rival = scored.find(|(e, m)| *e > RIVAL * explained && (m.focal / map.focal).ln().abs() > SAME_FOCAL);
        Selected { map, rival_focal: rival.map(|(_, m)| m.focal) }
    }))
}

/// Bundle adjustment with the narrow loss, so that maps which only stopped short of one another meet.
fn polish(
    maps: &mut [Map],
    tracks: &[RawTrack],
    median_px: f64,
    free_focal: bool,
    limits: &Limits,
    progress: &dyn Progress,
) {
    let mut narrow = *limits;
    narrow.sharpen(median_px);
    let options = bundle_options(&narrow, free_focal);
    for map in maps {
        map.adjust(tracks, &options, progress);
    }
}

/// Starts that are tried in any case.
const ENOUGH: usize = 3;

/// The best start, two others whose focal lengths differ from those taken by a third, then all other
/// pairs of the best focal length.
fn order(starts: &[Start]) -> Vec<&Start> {
    let mut picked: Vec<&Start> = Vec::new();
    for start in starts {
        let apart = picked.iter().all(|p| (p.focal / start.focal).ln().abs() > 0.28);
        if picked.len() < ENOUGH && apart {
            picked.push(start);
        }
    }
    if let Some(best) = starts.first() {
        let again = starts.iter().filter(|s| s.focal == best.focal && s.pair != best.pair);
        picked.extend(again);
    }
    picked
}
