//! Points followed along optical flow, frame by frame, and brought into the world with the depth
//! under them; without weights.

use super::clip::{Strip, dynamic_disparity, sparse_flow_pair};
use super::fill::State;
use super::tracker::{nearest, thinned};
use super::{Board, CaptureClip, PosedFrame, QueryGrid, TrackError, TrackInputs, fill, seed};
use m4_core::{Progress, Tracks, quantile};
use rayon::prelude::*;

/// Frames whose images are in memory at a time.
const BATCH: usize = 8;
/// Most places of all tracks together: a place takes 17 bytes while points are followed.
const MOST_PLACES: usize = 8_000_000;
/// Time over which the depth of a track is smoothed, standard deviation in frames.
const SMOOTH_FRAMES: f32 = 2.0;

/// Follows the dynamic points of a clip (Minute4D Eq. 5, without a network): chains along optical
/// flow, lifted with depth (docs/spec/front-end.md 7.1, item 8), and carried on where they are
/// hidden with the local rigid motion of their neighbours (docs/spec/front-end.md 3, "cheaper
/// substitute"). No point starts where a chain passes, and a chain that jumps becomes several
/// tracks.
///
/// Frames are followed at the size that the clip has. Of each, flow and depth of dynamic regions
/// are kept; images are read a few at a time. The same clip and grid give the same bits for any
/// number of threads.
///
/// # Errors
///
/// [`TrackError`] for an unusable grid, where a frame cannot be used, or the user stops.
pub fn follow(
    clip: &CaptureClip<'_>,
    grid: &QueryGrid,
    progress: &dyn Progress,
) -> Result<Tracks, TrackError> {
    grid.check()?;
    let strip = strip(clip, progress)?;
    let mut board = board_of(clip.frames(), &on_grid(&strip, grid));
    let surface = |i: usize| Ok(clip.read(i)?.depth);
    fill(
        &TrackInputs {
            strip: &strip,
            surface: &surface,
        },
        &mut board,
        progress,
    )?;
    followed(board)
}

/// The board as an answer.
pub(crate) fn followed(board: Board) -> Result<Tracks, TrackError> {
    let visible = board.state.iter().map(|s| *s == State::Seen).collect();
    let tracks = Tracks::new(board.frames, board.count, board.places, visible)?;
    Ok(tracks.with_confidence(&board.confidence)?)
}

/// Pieces as tracks.
pub(crate) fn board_of(frames: usize, pieces: &[Lifted]) -> Board {
    let mut board = Board::new(frames, pieces.len());
    for (k, piece) in pieces.iter().enumerate() {
        board.put(k, piece);
    }
    board
}

/// Chains that start at regular intervals of frames, each from the cells of a grid that no chain
/// passes, in the world.
pub(crate) fn on_grid(strip: &Strip, grid: &QueryGrid) -> Vec<Lifted> {
    let cell = grid.spacing_px.max(1);
    let columns = strip.width.div_ceil(cell);
    let cell_of = |at: &[f32; 2]| {
        let (x, y) = nearest(*at);
        y / cell * columns + x / cell
    };
    let mut all: Vec<Chain> = Vec::new();
    let frames = strip.dynamic.len();
    for start in grid.starts(frames) {
        let mut occupied = vec![false; columns * strip.height.div_ceil(cell)];
        for chain in &all {
            if let Some(at) = start
                .checked_sub(chain.first)
                .and_then(|k| chain.positions.get(k))
            {
                occupied[cell_of(at)] = true;
            }
        }
        let free = (0..occupied.len()).filter(|&c| !occupied[c]);
        let moves = |x: usize, y: usize| strip.dynamic[start].get(x, y).is_some();
        let size = (strip.width, strip.height);
        let seeds = free.filter_map(|c| seed(size, c % columns, c / columns, cell, &moves));
        let seeds: Vec<[f32; 2]> = seeds.collect();
        let chains: Vec<Chain> = seeds
            .par_iter()
            .map(|at| chain(strip, start, *at))
            .collect();
        all.extend(chains.into_iter().filter(|c| c.positions.len() >= SHORTEST));
    }
    let lifted: Vec<Vec<Lifted>> = all.par_iter().map(|chain| lift(strip, chain)).collect();
    let lifted: Vec<Lifted> = lifted.into_iter().flatten().collect();
    thinned(&lifted, grid.most.min(MOST_PLACES / frames.max(1)))
}

/// Flow and depth of dynamic regions in the whole clip.
fn strip(clip: &CaptureClip<'_>, progress: &dyn Progress) -> Result<Strip, TrackError> {
    const PHASE: &str = "computing flow of dynamic objects";
    let frames = clip.frames();
    let mut out = Strip {
        width: clip.size().0,
        height: clip.size().1,
        cameras: Vec::with_capacity(frames),
        dynamic: Vec::with_capacity(frames),
        forward: Vec::new(),
        backward: Vec::new(),
    };
    let mut last: Option<PosedFrame> = None;
    for from in (0..frames).step_by(BATCH) {
        if progress.cancelled() {
            return Err(TrackError::Cancelled { phase: PHASE });
        }
        let to = (from + BATCH).min(frames);
        let read: Vec<Result<PosedFrame, TrackError>> =
            (from..to).into_par_iter().map(|i| clip.read(i)).collect();
        // the last frame of the batch before, and this batch
        let mut batch: Vec<PosedFrame> = last.take().into_iter().collect();
        let carried = batch.len();
        for frame in read {
            batch.push(frame?);
        }
        out.cameras
            .extend(batch[carried..].iter().map(|f| f.camera));
        out.dynamic.extend(
            batch[carried..]
                .par_iter()
                .map(dynamic_disparity)
                .collect::<Vec<_>>(),
        );
        let pairs: Vec<_> = batch
            .par_windows(2)
            .map(|pair| sparse_flow_pair([&pair[0], &pair[1]]))
            .collect();
        for [forward, backward] in pairs {
            out.forward.push(forward);
            out.backward.push(backward);
        }
        progress.update(PHASE, to, frames, "");
        last = batch.pop();
    }
    Ok(out)
}

/// A point in consecutive frames.
#[derive(Debug, Clone)]
pub(crate) struct Chain {
    pub first: usize,
    /// Pixel coordinates in frames `first..`.
    pub positions: Vec<[f32; 2]>,
}

/// The chain through `at` of frame `start`, as far as it goes both ways.
pub(crate) fn chain(strip: &Strip, start: usize, at: [f32; 2]) -> Chain {
    let mut positions = one_way(strip, start, at, false);
    let first = start - positions.len();
    positions.reverse();
    positions.push(at);
    positions.extend(one_way(strip, start, at, true));
    Chain { first, positions }
}

/// Where the point at `at` of frame `start` is in the frames after it, or before, as far as it can
/// be followed.
pub(super) fn one_way(strip: &Strip, start: usize, at: [f32; 2], forward: bool) -> Vec<[f32; 2]> {
    let mut out = Vec::new();
    let (mut frame, mut at) = (start, at);
    while let Some((next, to)) = step(strip, frame, at, forward) {
        out.push(to);
        (frame, at) = (next, to);
    }
    out
}

/// Where a point is one frame on, or back.
fn step(strip: &Strip, frame: usize, at: [f32; 2], forward: bool) -> Option<(usize, [f32; 2])> {
    let next = if forward {
        frame + 1
    } else {
        frame.checked_sub(1)?
    };
    let [u, v] = flow_of_part(strip, frame, at, forward)?;
    let to = [at[0] + u, at[1] + v];
    let (x, y) = nearest(to);
    (is_inside(strip, to) && strip.dynamic.get(next)?.get(x, y).is_some()).then_some((next, to))
}

/// Whether a place is in the image.
pub(super) fn is_inside(strip: &Strip, at: [f32; 2]) -> bool {
    at[0] > -0.5
        && at[1] > -0.5
        && at[0] < strip.width as f32 - 0.5
        && at[1] < strip.height as f32 - 0.5
}

/// Bilinear flow of those of the four pixels around that move and lead back; none if the nearest
/// does not.
fn flow_of_part(strip: &Strip, frame: usize, at: [f32; 2], forward: bool) -> Option<[f32; 2]> {
    let flow = if forward {
        strip.forward.get(frame)?
    } else {
        strip.backward.get(frame.checked_sub(1)?)?
    };
    let (x, y) = nearest(at);
    flow.get(x, y)?;
    let (left, top) = (at[0].floor(), at[1].floor());
    let (fx, fy) = (at[0] - left, at[1] - top);
    let (mut u, mut v, mut total) = (0.0, 0.0, 0.0);
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let (px, py) = (left + dx, top + dy);
        if px < 0.0 || py < 0.0 {
            continue;
        }
        if let Some([to_right, down]) = flow.get(px as usize, py as usize) {
            let weight = (1.0 - (fx - dx).abs()) * (1.0 - (fy - dy).abs());
            u += weight * to_right;
            v += weight * down;
            total += weight;
        }
    }
    (total > 0.0).then(|| [u / total, v / total])
}

/// Fewest frames of a track.
pub(super) const SHORTEST: usize = 4;
/// A track is cut at a step longer than this many times its median step.
const JUMP: f32 = 5.0;
/// A step shorter than this is none that could be a jump, pixels.
const SMALL_STEP_PX: f64 = 3.0;

/// A point in the world, in consecutive frames.
#[derive(Debug, Clone)]
pub(crate) struct Lifted {
    pub first: usize,
    pub places: Vec<[f32; 3]>,
}

/// The pieces of a chain between jumps, in the world.
pub(crate) fn lift(strip: &Strip, chain: &Chain) -> Vec<Lifted> {
    let frames = || (chain.first..).zip(&chain.positions);
    let raw: Vec<f32> = frames()
        .map(|(frame, at)| around(strip, frame, *at))
        .collect();
    let place = |frame: usize, at: &[f32; 2], disparity: f32| {
        strip.cameras[frame].unproject(
            f64::from(at[0]),
            f64::from(at[1]),
            1.0 / f64::from(disparity),
        )
    };
    let places: Vec<_> = frames()
        .zip(&raw)
        .map(|((frame, at), d)| place(frame, at, *d))
        .collect();
    let steps: Vec<f32> = places
        .windows(2)
        .map(|p| (p[1] - p[0]).norm() as f32)
        .collect();
    let median = quantile(&mut steps.clone(), 0.5).unwrap_or(0.0);
    let jumps = |k: usize| {
        let small =
            SMALL_STEP_PX / (f64::from(raw[k]) * strip.cameras[chain.first + k].intrinsics.fx);
        !steps[k].is_finite() || steps[k] > JUMP * median + small as f32
    };
    let mut out = Vec::new();
    let mut from = 0;
    for to in 1..=raw.len() {
        if to < raw.len() && !jumps(to - 1) {
            continue;
        }
        if to - from >= SHORTEST {
            let depth = smooth(&raw[from..to], SMOOTH_FRAMES);
            let piece = (chain.first + from..)
                .zip(&chain.positions[from..to])
                .zip(&depth);
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

/// Median disparity of the dynamic pixels among 3x3: what leans over the edge of a mask does not
/// count.
pub(super) fn around(strip: &Strip, frame: usize, at: [f32; 2]) -> f32 {
    let (x, y) = nearest(at);
    let rows = y.saturating_sub(1)..(y + 2).min(strip.height);
    let pixels =
        rows.flat_map(|y| (x.saturating_sub(1)..(x + 2).min(strip.width)).map(move |x| (x, y)));
    let mut values: Vec<f32> = pixels
        .filter_map(|(x, y)| strip.dynamic[frame].get(x, y))
        .collect();
    quantile(&mut values, 0.5).unwrap_or(f32::NAN)
}

/// Disparity along a track, its logarithm smoothed by lines through the frames around each (weights
/// of standard deviation `sd` frames), so that what comes nearer steadily is not held back at the
/// ends.
pub(crate) fn smooth(disparity: &[f32], sd: f32) -> Vec<f32> {
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
mod tests {
    use super::smooth;

    #[test]
    fn a_steady_approach_is_not_held_back_at_the_ends() {
        let steady: Vec<f32> = (0..9).map(|t| 0.5 * 1.1f32.powi(t)).collect();
        for (got, want) in smooth(&steady, 2.0).iter().zip(&steady) {
            assert!((got / want - 1.0).abs() < 1e-5, "{got} {want}");
        }
        assert_eq!(smooth(&[0.5], 2.0), [0.5]);
    }
}
