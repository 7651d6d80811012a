//! Closes loops: where a place is seen again, cameras that drifted are laid over those of the first
//! time, and what they were off is spread over the way between.
//!
//! A frame that shows earlier points again (`revisits`) is placed a second time, by these points.
//! If most of them agree on that place, the frames since then are bent so that both places meet,
//! and bundle adjustment, in which these points keep their sightings of both times, does the rest.

use super::bundle::BundleOptions;
use super::map::Map;
use super::reconstruct::SparseProblem;
use super::revisits::LEAST_MATCHES;
use super::tracking::RawTrack;
use super::triangulate::{Sighting, error_px, resect};
use super::{INLIER_PX, SparseError, stopped};
use m4_core::nalgebra::Vector3;
use m4_core::{Se3, exp_so3, log_so3, median};
use std::collections::BTreeMap;

/// Share of the sightings of a frame that must agree on its place.
const AGREEMENT: f64 = 0.5;
/// Places whose sightings are off by less than this are left to bundle adjustment, working pixels.
const CLOSE_PX: f64 = 2.0 * INLIER_PX;
/// Most loops that are closed one after the other.
const MOST_LOOPS: usize = 8;
/// Scale of the Cauchy loss while a loop settles, working pixels.
const WIDE_PX: f64 = 4.0;
/// A loop is real if this share of the points survives that it is closed.
const SURVIVORS: f64 = 0.95;
/// Depth of old and new points is compared where they are this close, working pixels.
const BESIDE_PX: f64 = 8.0;
/// ... at this many places at least.
const LEAST_DEPTHS: usize = 10;

/// A frame that shows an earlier place again.
struct Revisit {
    /// The frame, and one of the first time.
    frame: usize,
    earlier: usize,
    /// World to camera by the earlier points.
    pose: Se3<f64>,
    /// Units of the earlier world in one of the later.
    scale: f64,
    /// By how much sightings are off by the pose that the frame has, median, working pixels.
    off_px: f64,
}

impl SparseProblem<'_> {
    /// Closes the loops of `map`; sightings that no place agrees with are dropped.
    pub(super) fn close_loops(&mut self, map: &mut Map) -> Result<(), SparseError> {
        let frames = again(&self.tracks);
        let mut agreed = BTreeMap::new();
        for (&frame, sightings) in &frames {
            stopped(self.progress)?;
            if let Some((_, agreeing)) = place(map, &self.tracks, frame, sightings) {
                agreed.insert(frame, agreeing);
            }
        }
        keep(&mut self.tracks, &agreed);
        if agreed.is_empty() {
            return Ok(());
        }
        map.loops_closed = true;
        let (before, points) = (map.clone(), map.points.iter().flatten().count());
        let wide = BundleOptions {
            cauchy_px: WIDE_PX,
            ..BundleOptions::whole(&self.limits, super::growth::ROUGH, self.free_focal())
        };
        for closed in 0..MOST_LOOPS {
            let open = agreed.iter().find_map(|(&frame, sightings)| {
                let (revisit, _) = place(map, &self.tracks, frame, sightings)?;
                (revisit.off_px > CLOSE_PX).then_some(revisit)
            });
            match open {
                Some(revisit) => bend(map, &revisit),
                None if closed > 0 => break,
                None => {}
            }
            map.triangulate(&self.tracks, &[], &self.limits);
            map.adjust(&self.tracks, &wide, self.progress);
            stopped(self.progress)?;
            map.triangulate(&self.tracks, &[], &self.limits);
            let note = format!("{} frames show earlier places", agreed.len());
            self.progress
                .update("closing loops", closed + 1, MOST_LOOPS, &note);
        }
        let survivors = map.points.iter().flatten().count();
        if (survivors as f64) < SURVIVORS * points as f64 {
            // two places that look alike
            *map = before;
            keep(&mut self.tracks, &BTreeMap::new());
        }
        Ok(())
    }
}

/// The track of an earlier point, and where it is in a later frame.
type Sighted = (usize, [f64; 2]);

/// The same by frame.
type Sightings = BTreeMap<usize, Vec<Sighted>>;

fn again(tracks: &[RawTrack]) -> Sightings {
    let mut frames = Sightings::new();
    for (i, track) in tracks.iter().enumerate() {
        for &(frame, at) in &track.again {
            frames.entry(frame).or_default().push((i, at));
        }
    }
    frames
}

/// Drops all later sightings but `agreed`.
fn keep(tracks: &mut [RawTrack], agreed: &Sightings) {
    for track in tracks.iter_mut() {
        track.again.clear();
    }
    for (&frame, sightings) in agreed {
        for &(track, at) in sightings {
            tracks[track].again.push((frame, at));
        }
    }
}

/// Places a frame by what it shows again, with the sightings that agree; `None` where too few do.
fn place(
    map: &Map,
    tracks: &[RawTrack],
    frame: usize,
    sightings: &[Sighted],
) -> Option<(Revisit, Vec<Sighted>)> {
    let pose_now = map.poses[frame]?;
    let (held, points): (Vec<Sighted>, Vec<Sighting>) = sightings
        .iter()
        .filter_map(|&(i, at)| Some(((i, at), (map.points[i]?, at))))
        .unzip();
    let mut middles: Vec<f64> = held
        .iter()
        .map(|(i, _)| 0.5 * (tracks[*i].first + tracks[*i].end()) as f64)
        .collect();
    let earlier = median(&mut middles)? as usize;
    let (pose, inliers) = resect(&points, map.focal, &map.poses[earlier]?);
    if inliers < LEAST_MATCHES || (inliers as f64) < AGREEMENT * points.len() as f64 {
        return None;
    }
    let off = |pose: &Se3<f64>, (x, at): &Sighting| {
        error_px(pose, x, map.focal, *at).unwrap_or(f64::INFINITY)
    };
    let agrees = |s: &Sighting| off(&pose, s) < INLIER_PX;
    let mut errors: Vec<f64> = points
        .iter()
        .filter(|s| agrees(s))
        .map(|s| off(&pose_now, s))
        .collect();
    let agreeing = held.iter().zip(&points).filter(|(_, s)| agrees(s));
    let revisit = Revisit {
        frame,
        earlier,
        pose,
        scale: scale(map, tracks, frame, &pose, &points),
        off_px: median(&mut errors)?,
    };
    Some((revisit, agreeing.map(|(h, _)| *h).collect()))
}

/// Depth of earlier points in the place by `pose` over depth of the points that are tracked there.
fn scale(map: &Map, tracks: &[RawTrack], frame: usize, pose: &Se3<f64>, old: &[Sighting]) -> f64 {
    let Some(now) = map.poses[frame] else {
        return 1.0;
    };
    let new = map.sightings(tracks, frame);
    let mut ratios: Vec<f64> = old
        .iter()
        .filter_map(|(x, at)| {
            let distance = |p: &[f64; 2]| (p[0] - at[0]).hypot(p[1] - at[1]);
            let nearest = new
                .iter()
                .min_by(|a, b| distance(&a.1).total_cmp(&distance(&b.1)))?;
            let depths = [pose.transform(x).z, now.transform(&nearest.0).z];
            (distance(&nearest.1) < BESIDE_PX && depths.iter().all(|z| *z > 0.0))
                .then(|| depths[0] / depths[1])
        })
        .collect();
    if ratios.len() < LEAST_DEPTHS {
        return 1.0;
    }
    median(&mut ratios).unwrap_or(1.0)
}

/// Moves the cameras after the first time so that the frame is where the earlier points have it.
/// Drift of heading and scale grows along the way; what is left is spread evenly.
fn bend(map: &mut Map, revisit: &Revisit) {
    let (from, to) = (revisit.earlier, revisit.frame);
    let Some(end) = map.poses[to] else { return };
    let turn = log_so3(&(revisit.pose.rotation.transpose() * end.rotation));
    let centre = |pose: &Se3<f64>| pose.inverse().translation;
    let placed: Vec<(usize, Se3<f64>)> = (from..map.poses.len())
        .filter_map(|i| Some((i, map.poses[i]?)))
        .collect();
    let mut way = vec![0.0];
    for pair in placed.windows(2) {
        way.push(way[way.len() - 1] + (centre(&pair[1].1) - centre(&pair[0].1)).norm());
    }
    let last = placed.partition_point(|(i, _)| *i < to);
    let whole = way.get(last).copied().filter(|w| *w > 0.0).unwrap_or(1.0);
    let share = |k: usize| (way[k] / whole).min(1.0);
    let correction = |s: f64| exp_so3(&(turn * s)) * revisit.scale.powf(s);
    let mut centres: Vec<Vector3<f64>> = Vec::with_capacity(placed.len());
    for (k, (_, pose)) in placed.iter().enumerate() {
        centres.push(match k.checked_sub(1) {
            None => centre(pose),
            Some(before) => {
                let step = centre(pose) - centre(&placed[before].1);
                centres[before] + correction(0.5 * (share(before) + share(k))) * step
            }
        });
    }
    let left = centres
        .get(last)
        .map_or_else(Vector3::zeros, |c| centre(&revisit.pose) - c);
    for (k, (i, pose)) in placed.iter().enumerate() {
        let c2w = Se3 {
            rotation: exp_so3(&(turn * share(k))) * pose.rotation.transpose(),
            translation: centres[k] + left * share(k),
        };
        map.poses[*i] = Some(c2w.inverse());
    }
}
