//! Which of several starts the reconstruction goes on with.

use super::adjustment::bundle_options;
use super::growth::{Start, grow};
use super::limits::Limits;
use super::map::Map;
use super::tracking::RawTrack;
use super::{INLIER_PX, SparseError, stopped};
use m4_core::Progress;

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
        Selected {
            map,
            rival_focal: rival.map(|(_, m)| m.focal),
        }
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
