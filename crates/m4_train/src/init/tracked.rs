//! Adds tracked points to those of the frames: the completed cloud (Minute4D sec. 3.2;
//! docs/spec/optimiser.md 2.6).
//!
//! A track knows where its point is in frames that cannot see it. There is one point a track and
//! keyframe, of the time of that keyframe; it is left out where it is not to be trusted, floats in
//! front of what the frame sees, no camera of the clip looks there, or the track jumps. Points of
//! the frames are better where both exist: tracks fill only cells that are empty in that keyframe.

use crate::init::{
    InitConfig, VelocityInit,
    visible::is_visible,
    voxel::{Centroids, Grid},
};
use m4_core::{Capture, CaptureFrame, Tracks};
use rayon::prelude::*;

/// Cameras of the clip that are asked whether they look at a place.
const CAMERAS: usize = 32;
/// Places that are trusted less than this are dropped where they lie outside the range of depths
/// that frames see (our rule).
const LEAST_CONFIDENCE: f32 = 0.5;
/// Places in front of what the frame sees by more than this share of the depth are dropped
/// (docs/spec/optimiser.md 2.6: 5 %).
const FREE_SPACE: f32 = 0.05;
/// Places that a track reaches or leaves by a step of more than this many times its median step are
/// dropped (our rule).
const JUMP: f32 = 8.0;
/// A step shorter than this share of the median depth is no jump.
const SMALL_STEP: f32 = 0.01;

/// A place behind the depth map by more than this share of the depth is hidden
/// (docs/decisions/0004).
const HIDDEN: f32 = 0.02;

/// Points of tracks at a keyframe.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tracked {
    pub points: Centroids,
    /// World units per frame.
    pub velocity: Vec<[f32; 3]>,
}

/// The parts of an initialisation that points of tracks are tested against.
pub(crate) struct TrackContext<'a> {
    pub capture: &'a Capture,
    /// The frame of each keyframe.
    pub frames: &'a [usize],
    /// Time and points of each keyframe.
    pub dynamic: &'a [(f64, Centroids)],
    pub grid: &'a Grid,
    /// Depth above which, and below which, 99 of 100 pixels lie, world units.
    pub depth_range: [f64; 2],
    pub median_depth: f64,
}

/// A point of a track at a keyframe.
struct Sample {
    key: (i16, u64),
    xyz: [f32; 3],
    rgb: [f32; 3],
    velocity: [f32; 3],
}

/// For every keyframe the points of tracks that it lacks.
pub(crate) fn tracked(context: &TrackContext<'_>, config: &InitConfig) -> Vec<Tracked> {
    let none = || vec![Tracked::default(); context.frames.len()];
    let Some(tracks) = context
        .capture
        .tracks
        .as_ref()
        .filter(|_| config.tracked.enabled)
    else {
        return none();
    };
    let every = context.capture.frames.len().div_ceil(CAMERAS).max(1);
    let cameras: Vec<&CaptureFrame> = context.capture.frames.iter().step_by(every).collect();
    let summaries: Vec<TrackSummary> = (0..tracks.count())
        .into_par_iter()
        .map(|k| TrackSummary::of(context.capture, tracks, k))
        .collect();
    let mut out: Vec<Vec<Sample>> = (0..context.frames.len())
        .into_par_iter()
        .map(|i| samples(context, tracks, &summaries, &cameras, i, config))
        .collect();
    let total: usize = out.iter().map(Vec::len).sum();
    if total > config.tracked.most {
        // thinned everywhere alike
        let mut at = 0;
        for samples in &mut out {
            samples.retain(|_| {
                at += 1;
                at * config.tracked.most / total > (at - 1) * config.tracked.most / total
            });
        }
    }
    out.into_iter()
        .map(|samples| collect(samples, context.grid))
        .collect()
}

fn collect(samples: Vec<Sample>, grid: &Grid) -> Tracked {
    let mut out = Tracked::default();
    for s in samples {
        out.points.xyz.push(s.xyz);
        out.points.rgb.push(s.rgb);
        out.points.edge.push(grid.edge(s.xyz));
        out.points.key.push(s.key);
        out.velocity.push(s.velocity);
    }
    out
}

/// A track over the whole clip.
struct TrackSummary {
    /// The median length of its steps, world units per frame.
    step: f32,
    /// 0..1; `None` where it was never seen and the tracker says nothing.
    rgb: Option<[f32; 3]>,
}

impl TrackSummary {
    fn of(capture: &Capture, tracks: &Tracks, track: usize) -> Self {
        let places = (0..tracks.frames()).filter_map(|t| Some((t, tracks.place(t, track)?)));
        let places: Vec<(usize, [f32; 3])> = places.collect();
        let mut steps: Vec<f32> = places.windows(2).map(|w| speed(w[0], w[1])).collect();
        let step = m4_core::median(&mut steps).unwrap_or(0.0);
        let observations = places
            .iter()
            .filter(|(t, _)| tracks.visible()[t * tracks.count() + track]);
        let colours: Vec<[u8; 3]> = observations
            .filter_map(|&(t, p)| colour(&capture.frames[t], p))
            .collect();
        let track_colour = || Some(tracks.colours()?[track].map(|c| f32::from(c) / 255.0));
        Self {
            step,
            rgb: robust_mean(&colours).or_else(track_colour),
        }
    }
}

/// World units per frame between two places.
fn speed((a, p): (usize, [f32; 3]), (b, q): (usize, [f32; 3])) -> f32 {
    let length = (0..3).map(|k| (q[k] - p[k]).powi(2)).sum::<f32>().sqrt();
    length / b.abs_diff(a).max(1) as f32
}

/// The colour of the pixel that shows a place.
fn colour(frame: &CaptureFrame, p: [f32; 3]) -> Option<[u8; 3]> {
    let ([u, v], z) = frame.camera.project(&p.map(f64::from).into());
    let (w, h) = frame.rgb.size();
    let inside = z > 0.0 && u > -0.5 && v > -0.5 && u < w as f64 - 0.5 && v < h as f64 - 0.5;
    inside.then(|| {
        frame.rgb[(
            ((u + 0.5) as usize).min(w - 1),
            ((v + 0.5) as usize).min(h - 1),
        )]
    })
}

/// The mean of the middle half of each channel, 0..1.
fn robust_mean(colours: &[[u8; 3]]) -> Option<[f32; 3]> {
    if colours.is_empty() {
        return None;
    }
    Some([0, 1, 2].map(|c| {
        let mut values: Vec<u8> = colours.iter().map(|rgb| rgb[c]).collect();
        values.sort_unstable();
        let quarter = values.len() / 4;
        let middle = &values[quarter..values.len() - quarter];
        middle.iter().map(|&v| f32::from(v)).sum::<f32>() / (255.0 * middle.len() as f32)
    }))
}

/// The points that keyframe `i` gets, one per cell, in order of cells.
fn samples(
    context: &TrackContext<'_>,
    tracks: &Tracks,
    summaries: &[TrackSummary],
    cameras: &[&CaptureFrame],
    i: usize,
    config: &InitConfig,
) -> Vec<Sample> {
    let (at, frame) = (
        context.frames[i],
        &context.capture.frames[context.frames[i]],
    );
    let velocities = Velocities::new(context, tracks, i, config);
    let mut out: Vec<Sample> = Vec::new();
    for (k, summary) in summaries.iter().enumerate() {
        let (Some(xyz), Some(rgb)) = (tracks.place(at, k), summary.rgb) else {
            continue;
        };
        let own = !config.tracked.seen && is_visible(frame, xyz, HIDDEN);
        if own || !is_plausible(context, tracks, (k, summary), (at, xyz), cameras) {
            continue;
        }
        let key = context.grid.key(xyz);
        if context.dynamic[i].1.key.binary_search(&key).is_ok() {
            continue;
        }
        let velocity = velocities.of(k).unwrap_or([0.0; 3]);
        out.push(Sample {
            key,
            xyz,
            rgb,
            velocity,
        });
    }
    // a stable sort, so that samples of a cell stay in the order of their tracks
    out.sort_by_key(|s| s.key);
    out.chunk_by(|a, b| a.key == b.key).map(mean).collect()
}

fn mean(cell: &[Sample]) -> Sample {
    let of = |f: fn(&Sample) -> [f32; 3]| {
        [0, 1, 2].map(|k| cell.iter().map(|s| f(s)[k]).sum::<f32>() / cell.len() as f32)
    };
    Sample {
        key: cell[0].key,
        xyz: of(|s| s.xyz),
        rgb: of(|s| s.rgb),
        velocity: of(|s| s.velocity),
    }
}

/// Whether a place of a track is to be believed.
fn is_plausible(
    context: &TrackContext<'_>,
    tracks: &Tracks,
    (track, summary): (usize, &TrackSummary),
    (at, xyz): (usize, [f32; 3]),
    cameras: &[&CaptureFrame],
) -> bool {
    let frame = &context.capture.frames[at];
    let (_, z) = frame.camera.project(&xyz.map(f64::from).into());
    let [near, far] = context.depth_range;
    if tracks.confidence(at, track) < LEAST_CONFIDENCE && !(near..=far).contains(&z) {
        return false;
    }
    if floats(frame, xyz) {
        return false;
    }
    if colour(frame, xyz).is_none() && !cameras.iter().any(|c| colour(c, xyz).is_some()) {
        return false;
    }
    let before = (0..at)
        .rev()
        .find_map(|t| Some((t, tracks.place(t, track)?)));
    let after = (at + 1..tracks.frames()).find_map(|t| Some((t, tracks.place(t, track)?)));
    let most = (JUMP * summary.step).max(SMALL_STEP * context.median_depth as f32);
    [before, after]
        .into_iter()
        .flatten()
        .all(|other| speed((at, xyz), other) <= most)
}

/// Whether a frame sees something farther where the place is, by more than [`FREE_SPACE`] of its
/// depth, in all of 3x3 pixels.
fn floats(frame: &CaptureFrame, p: [f32; 3]) -> bool {
    let Some(depth) = &frame.depth else {
        return false;
    };
    let (w, h) = depth.size();
    let ([u, v], z) = frame.camera.resized(w, h).project(&p.map(f64::from).into());
    let inside = z > 0.0 && u > -0.5 && v > -0.5 && u < w as f64 - 0.5 && v < h as f64 - 0.5;
    if !inside {
        return false;
    }
    let (x, y) = ((u + 0.5) as usize, (v + 0.5) as usize);
    let rows = y.saturating_sub(1)..(y + 2).min(h);
    let around = rows.flat_map(|y| (x.saturating_sub(1)..(x + 2).min(w)).map(move |x| (x, y)));
    let depths = around
        .map(|(x, y)| depth.at(x, y))
        .filter(|d| d.is_finite() && *d > 0.0);
    depths
        .min_by(f32::total_cmp)
        .is_some_and(|least| z < f64::from(least * (1.0 - FREE_SPACE)))
}

/// How tracks move at a keyframe.
struct Velocities<'a> {
    capture: &'a Capture,
    tracks: &'a Tracks,
    at: usize,
    /// Frames on each side.
    reach: usize,
    zero: bool,
}

impl<'a> Velocities<'a> {
    fn new(context: &TrackContext<'a>, tracks: &'a Tracks, i: usize, config: &InitConfig) -> Self {
        let gap = match context.frames {
            [first, .., last] => last.abs_diff(*first) / (context.frames.len() - 1),
            _ => 1,
        };
        Self {
            capture: context.capture,
            tracks,
            at: context.frames[i],
            reach: (gap / 2).max(1),
            zero: matches!(config.velocity, VelocityInit::Zero),
        }
    }

    /// World units per frame: from half a gap between keyframes before to half a gap after, as far
    /// as the track is known there.
    fn of(&self, track: usize) -> Option<[f32; 3]> {
        if self.zero {
            return None;
        }
        let here = (self.at, self.tracks.place(self.at, track)?);
        let side = |t: Option<usize>| t.and_then(|t| Some((t, self.tracks.place(t, track)?)));
        let before = side(self.at.checked_sub(self.reach)).unwrap_or(here);
        let after = side(Some(self.at + self.reach)).unwrap_or(here);
        let time = |t: usize| self.capture.frames[t].t;
        let gap = (time(after.0) - time(before.0)) as f32;
        (gap != 0.0).then(|| [0, 1, 2].map(|k| (after.1[k] - before.1[k]) / gap))
    }
}
