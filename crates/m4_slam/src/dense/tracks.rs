//! Points of moving parts followed along the flow and lifted with their depth.
//!
//! ```text
//! grid of moving pixels without a track -> chain there and back in time -> depth of each place -> world
//!                                                                  cut at jumps, smoothed -> Tracks
//! ```
//!
//! Section 7.1, item 8, of the front-end specification ("3D tracks by flow chaining + lifting"), which is the substitute of section
//! 2.6 for a network that tracks. A chain ends where the flow does not lead back, where it leaves the picture and
//! where it leaves the masks; what went behind something comes out as another track.
//!
//! Pixels here are those of the working size, with the centre of the first one at 0, 0, as [`Camera::unproject`] has them.

use super::config::TrackConfig;
use super::flow::{Flow, FlowPair};
use super::shot::quantile;
use m4_scene::{Camera, Tracks};
use rayon::prelude::*;

/// Most places that are handed out, all frames and tracks together: 12 bytes each, in a file and in memory.
const MOST_PLACES: usize = 8_000_000;
/// A step shorter than this is none that could be a jump, pixels.
const SMALL_STEP_PX: f64 = 3.0;

/// Everything that chains are made of, at the working size.
pub(super) struct Clip<'a> {
    pub width: usize,
    pub height: usize,
    pub cameras: &'a [Camera],
    /// Masks, `[frames][height][width]`, above 0 where something moves.
    pub moving: &'a [Vec<u8>],
    /// One over z-depth, `[frames][height][width]`.
    pub disparity: &'a [Vec<f32>],
    pub flows: &'a [FlowPair],
}

/// A point in consecutive frames.
struct Chain {
    first: usize,
    /// Pixel coordinates in frames `first..`.
    seen: Vec<[f32; 2]>,
}

/// A point in the world, in consecutive frames.
struct Lifted {
    first: usize,
    places: Vec<[f32; 3]>,
}

/// Tracks of everything that moves; `None` if nothing could be followed.
pub(super) fn tracks(clip: &Clip<'_>, config: &TrackConfig) -> Option<Tracks> {
    let frames = clip.moving.len();
    let most = config.most.min(MOST_PLACES / frames.max(1));
    let chains = chains(clip, config);
    let lifted: Vec<Vec<Lifted>> = chains.par_iter().map(|chain| lift(clip, chain, config)).collect();
    let lifted: Vec<Lifted> = lifted.into_iter().flatten().collect();
    // Too many are thinned everywhere alike.
    let count = lifted.len().min(most);
    if count == 0 {
        return None;
    }
    let kept = (0..count).map(|k| &lifted[k * lifted.len() / count]);
    let mut xyz = vec![[f32::NAN; 3]; frames * count];
    let mut visible = vec![false; frames * count];
    for (k, track) in kept.enumerate() {
        for (frame, place) in (track.first..).zip(&track.places) {
            xyz[frame * count + k] = *place;
            visible[frame * count + k] = true;
        }
    }
    Tracks::new(frames, count, xyz, visible).ok()
}

/// Chains from every so many frames, each from the cells of a grid that no chain passes.
fn chains(clip: &Clip<'_>, config: &TrackConfig) -> Vec<Chain> {
    let (w, h, cell) = (clip.width, clip.height, config.spacing_px.max(1));
    let columns = w.div_ceil(cell);
    let cell_of = |at: &[f32; 2]| {
        let (x, y) = nearest(at);
        y / cell * columns + x / cell
    };
    let mut all: Vec<Chain> = Vec::new();
    let frames = clip.moving.len();
    for start in (0..frames).filter(|i| i % config.every.max(1) == 0 || i + 1 == frames) {
        let mut taken = vec![false; columns * h.div_ceil(cell)];
        for chain in &all {
            if let Some(at) = start.checked_sub(chain.first).and_then(|k| chain.seen.get(k)) {
                taken[cell_of(at)] = true;
            }
        }
        let free = (0..taken.len()).filter(|&c| !taken[c]);
        let seeds = free.filter_map(|c| seed(clip, start, c % columns, c / columns, cell));
        let seeds: Vec<[f32; 2]> = seeds.collect();
        let found: Vec<Chain> = seeds.par_iter().map(|at| chain(clip, start, *at, config)).collect();
        all.extend(found.into_iter().filter(|c| c.seen.len() >= config.shortest));
    }
    all
}

/// The moving pixel of a cell that is nearest to its middle.
fn seed(clip: &Clip<'_>, frame: usize, column: usize, row: usize, cell: usize) -> Option<[f32; 2]> {
    let (left, top) = (column * cell, row * cell);
    let (mx, my) = (2 * left + cell - 1, 2 * top + cell - 1);
    let pixels =
        (top..(top + cell).min(clip.height)).flat_map(|y| (left..(left + cell).min(clip.width)).map(move |x| (x, y)));
    pixels
        .filter(|&(x, y)| clip.moving[frame][y * clip.width + x] > 0)
        .min_by_key(|&(x, y)| (2 * x).abs_diff(mx).pow(2) + (2 * y).abs_diff(my).pow(2))
        .map(|(x, y)| [x as f32, y as f32])
}

fn nearest(at: &[f32; 2]) -> (usize, usize) {
    ((at[0] + 0.5).max(0.0) as usize, (at[1] + 0.5).max(0.0) as usize)
}

/// The chain through `at` of frame `start`, as far as it goes both ways.
fn chain(clip: &Clip<'_>, start: usize, at: [f32; 2], config: &TrackConfig) -> Chain {
    let way = |forward: bool| {
        let mut out = Vec::new();
        let (mut frame, mut at) = (start, at);
        while let Some((next, to)) = step(clip, frame, at, forward, config.round_trip_px) {
            out.push(to);
            (frame, at) = (next, to);
        }
        out
    };
    let mut seen = way(false);
    let first = start - seen.len();
    seen.reverse();
    seen.push(at);
    seen.extend(way(true));
    Chain { first, seen }
}

/// Where a point is one frame on, or back.
fn step(clip: &Clip<'_>, frame: usize, at: [f32; 2], forward: bool, trip_px: f32) -> Option<(usize, [f32; 2])> {
    let (next, flow, trip) = if forward {
        let pair = clip.flows.get(frame)?;
        (frame + 1, &pair.forward, &pair.forward_round_trip)
    } else {
        let next = frame.checked_sub(1)?;
        let pair = clip.flows.get(next)?;
        (next, &pair.backward, &pair.backward_round_trip)
    };
    let (u, v) = flow_of_part(clip, flow, trip, &clip.moving[frame], at, trip_px)?;
    let to = [at[0] + u, at[1] + v];
    let inside = to[0] > -0.5 && to[1] > -0.5 && to[0] < clip.width as f32 - 0.5 && to[1] < clip.height as f32 - 0.5;
    let (x, y) = nearest(&to);
    (inside && clip.moving.get(next)?[y * clip.width + x] > 0).then_some((next, to))
}

/// Bilinear flow of those of the four pixels around that move and lead back; none if the nearest does not.
fn flow_of_part(
    clip: &Clip<'_>,
    flow: &Flow,
    trip: &[f32],
    moving: &[u8],
    at: [f32; 2],
    trip_px: f32,
) -> Option<(f32, f32)> {
    let good = |x: usize, y: usize| {
        let p = y * clip.width + x;
        (x < clip.width && y < clip.height && moving[p] > 0 && trip[p] <= trip_px).then_some(p)
    };
    let (x, y) = nearest(&at);
    good(x, y)?;
    let (left, top) = (at[0].floor(), at[1].floor());
    let (fx, fy) = (at[0] - left, at[1] - top);
    let (mut u, mut v, mut total) = (0.0, 0.0, 0.0);
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let (px, py) = (left + dx, top + dy);
        if px < 0.0 || py < 0.0 {
            continue;
        }
        if let Some(p) = good(px as usize, py as usize) {
            let weight = (1.0 - (fx - dx).abs()) * (1.0 - (fy - dy).abs());
            u += weight * flow.u[p];
            v += weight * flow.v[p];
            total += weight;
        }
    }
    (total > 0.0).then(|| (u / total, v / total))
}

/// The pieces of a chain between jumps, in the world.
fn lift(clip: &Clip<'_>, chain: &Chain, config: &TrackConfig) -> Vec<Lifted> {
    let frames = || (chain.first..).zip(&chain.seen);
    let raw: Vec<f32> = frames().map(|(frame, at)| around(clip, frame, at)).collect();
    let place = |frame: usize, at: &[f32; 2], disparity: f32| {
        clip.cameras[frame].unproject(f64::from(at[0]), f64::from(at[1]), 1.0 / f64::from(disparity))
    };
    let places: Vec<_> = frames()
        .zip(&raw)
        .map(|((frame, at), d)| place(frame, at, *d))
        .collect();
    let steps: Vec<f32> = places.windows(2).map(|p| (p[1] - p[0]).norm() as f32).collect();
    let median = quantile(&mut steps.clone(), 0.5).unwrap_or(0.0);
    let jumps = |k: usize| {
        let small = SMALL_STEP_PX / (f64::from(raw[k]) * clip.cameras[chain.first + k].intrinsics.fx);
        !steps[k].is_finite() || steps[k] > config.jump * median + small as f32
    };
    let mut out = Vec::new();
    let mut from = 0;
    for to in 1..=raw.len() {
        if to < raw.len() && !jumps(to - 1) {
            continue;
        }
        if to - from >= config.shortest {
            let depth = smooth(&raw[from..to], config.smooth_frames);
            let piece = (chain.first + from..).zip(&chain.seen[from..to]).zip(&depth);
            let places: Vec<[f32; 3]> = piece
                .map(|((frame, at), d)| place(frame, at, *d))
                .map(|p| [p.x as f32, p.y as f32, p.z as f32])
                .collect();
            if places.as_flattened().iter().all(|v| v.is_finite()) {
                let first = chain.first + from;
                out.push(Lifted { first, places });
            }
        }
        from = to;
    }
    out
}

/// Median disparity of the moving ones of 3x3 pixels: what leans over the edge of a mask does not count.
fn around(clip: &Clip<'_>, frame: usize, at: &[f32; 2]) -> f32 {
    let (x, y) = nearest(at);
    let rows = y.saturating_sub(1)..(y + 2).min(clip.height);
    let pixels = rows.flat_map(|y| (x.saturating_sub(1)..(x + 2).min(clip.width)).map(move |x| (x, y)));
    let moving = pixels
        .map(|(x, y)| y * clip.width + x)
        .filter(|&p| clip.moving[frame][p] > 0);
    let mut values: Vec<f32> = moving.map(|p| clip.disparity[frame][p]).collect();
    quantile(&mut values, 0.5).unwrap_or(f32::NAN)
}

/// Disparity along a track, its logarithm smoothed by lines through the frames around each (weights of standard deviation
/// `sd` frames), so that what comes nearer steadily is not held back at the ends.
fn smooth(disparity: &[f32], sd: f32) -> Vec<f32> {
    if sd <= 0.0 {
        return disparity.to_vec();
    }
    let logs: Vec<f64> = disparity.iter().map(|d| f64::from(*d).ln()).collect();
    let reach = (3.0 * sd).ceil() as usize;
    (0..logs.len())
        .map(|i| {
            let (mut s, mut st, mut stt, mut sy, mut sty) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for j in i.saturating_sub(reach)..(i + reach + 1).min(logs.len()) {
                let t = j as f64 - i as f64;
                let w = (-0.5 * (t / f64::from(sd)).powi(2)).exp();
                s += w;
                st += w * t;
                stt += w * t * t;
                sy += w * logs[j];
                sty += w * t * logs[j];
            }
            let determinant = s * stt - st * st;
            let at_0 = if determinant > 1e-12 {
                (stt * sy - st * sty) / determinant
            } else {
                sy / s
            };
            at_0.exp() as f32
        })
        .collect()
}

#[cfg(test)]
#[path = "tracks_tests.rs"]
mod tests;
