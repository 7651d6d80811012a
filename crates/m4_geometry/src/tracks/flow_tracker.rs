//! Points followed along optical flow, without weights.

use super::clip::{Strip, frame_error, moving, read_checked, sparse_flow_pair};
use super::fill::State;
use super::grid::{nearest, thinned};
use super::lift::{Chain, SHORTEST, chain};
use super::{
    Board, Lifted, PosedClip, PosedFrame, Query, QueryGrid, Scene, TrackError, TrackedPoints, Tracker3d, fill, lift,
    seed,
};
use crate::classical::dense::FlowSource;
use m4_core::Progress;
use rayon::prelude::*;

/// Frames whose images are in memory at a time.
const BATCH: usize = 8;
/// Most places of all tracks together: a place takes 17 bytes while points are followed.
const MOST_PLACES: usize = 8_000_000;

/// How chains become tracks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackConfig {
    /// Whether points are carried on where they are hidden, with the local rigid motion of their neighbours (docs/spec/front-end.md 3,
    /// "cheaper substitute"); else a track ends where its chain ends.
    pub fill: bool,
    /// Time over which the depth of a track is smoothed, standard deviation in frames; 0 for none.
    pub smooth_frames: f32,
}

impl Default for TrackConfig {
    fn default() -> Self {
        Self { fill: true, smooth_frames: 2.0 }
    }
}

/// Chains along optical flow, lifted with depth, carried on where they are hidden (docs/spec/front-end.md 7.1, item 8, and
/// the end of docs/spec/front-end.md 3).
///
/// Frames are followed at the size that the clip has. Of each, flow and depth of dynamic regions are kept; images are read a few at a time.
pub struct FlowTracker<'a> {
    /// Measures flow between neighbouring frames.
    pub flow: &'a dyn FlowSource,
    /// How chains are made and carried on. Where points start ([`QueryGrid`]) is the caller's word.
    pub config: TrackConfig,
}

impl Tracker3d for FlowTracker<'_> {
    /// No point starts where a chain passes, and a chain that jumps becomes several tracks.
    fn follow_grid(
        &self,
        clip: &dyn PosedClip,
        grid: &QueryGrid,
        progress: &dyn Progress,
    ) -> Result<TrackedPoints, TrackError> {
        grid.check()?;
        let strip = strip(clip, self.flow, progress)?;
        let pieces = on_grid(&strip, grid, &self.config);
        let (mut board, queries) = board_of(clip.frames(), &pieces);
        let surface = |i: usize| Ok(read_checked(clip, i)?.depth);
        let scene = Scene { strip: &strip, surface: &surface, config: &self.config };
        if self.config.fill {
            fill(&scene, &mut board, progress)?;
        }
        followed(board, queries)
    }
}

/// The board as an answer.
pub(crate) fn followed(board: Board, queries: Vec<Query>) -> Result<TrackedPoints, TrackError> {
    let visible = board.state.iter().map(|s| *s == State::Seen).collect();
    TrackedPoints::new(board.frames, queries, board.places, visible, board.confidence)
}

/// Pieces as tracks, and their first places as queries.
pub(crate) fn board_of(frames: usize, pieces: &[Lifted]) -> (Board, Vec<Query>) {
    let mut board = Board::new(frames, pieces.len());
    for (k, piece) in pieces.iter().enumerate() {
        board.put(k, piece);
    }
    let query = |piece: &Lifted| Some(Query { frame: piece.first, xyz: *piece.places.first()? });
    (board, pieces.iter().filter_map(query).collect())
}

/// Chains that start at regular intervals of frames, each from the cells of a grid that no chain passes, in the world.
pub(crate) fn on_grid(strip: &Strip, grid: &QueryGrid, config: &TrackConfig) -> Vec<Lifted> {
    let cell = grid.spacing_px.max(1);
    let columns = strip.width.div_ceil(cell);
    let cell_of = |at: &[f32; 2]| {
        let (x, y) = nearest(*at);
        y / cell * columns + x / cell
    };
    let mut all: Vec<Chain> = Vec::new();
    let frames = strip.moving.len();
    for start in grid.starts(frames) {
        let mut taken = vec![false; columns * strip.height.div_ceil(cell)];
        for chain in &all {
            if let Some(at) = start.checked_sub(chain.first).and_then(|k| chain.seen.get(k)) {
                taken[cell_of(at)] = true;
            }
        }
        let free = (0..taken.len()).filter(|&c| !taken[c]);
        let moves = |x: usize, y: usize| strip.moving[start].get(x, y).is_some();
        let size = (strip.width, strip.height);
        let seeds = free.filter_map(|c| seed(size, c % columns, c / columns, cell, &moves));
        let seeds: Vec<[f32; 2]> = seeds.collect();
        let found: Vec<Chain> = seeds.par_iter().map(|at| chain(strip, start, *at)).collect();
        all.extend(found.into_iter().filter(|c| c.seen.len() >= SHORTEST));
    }
    let lifted: Vec<Vec<Lifted>> = all.par_iter().map(|chain| lift(strip, chain, config)).collect();
    let lifted: Vec<Lifted> = lifted.into_iter().flatten().collect();
    thinned(&lifted, grid.most.min(MOST_PLACES / frames.max(1)))
}

/// Flow and depth of dynamic regions in the whole clip.
fn strip(clip: &dyn PosedClip, flow: &dyn FlowSource, progress: &dyn Progress) -> Result<Strip, TrackError> {
    const PHASE: &str = "computing flow of dynamic objects";
    let frames = clip.frames();
    let mut out = Strip {
        width: 0,
        height: 0,
        cameras: Vec::with_capacity(frames),
        moving: Vec::with_capacity(frames),
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
            (from..to).into_par_iter().map(|i| read_checked(clip, i)).collect();
        // the last frame of the batch before, and this batch
        let mut batch: Vec<PosedFrame> = last.take().into_iter().collect();
        let carried = batch.len();
        for (i, frame) in (from..to).zip(read) {
            let frame = frame?;
            let (w, h) = frame.rgb.size();
            if i > 0 && (w, h) != (out.width, out.height) {
                let reason = format!("it has {w}x{h} pixels where the first has {}x{}", out.width, out.height);
                return Err(frame_error(i, reason));
            }
            (out.width, out.height) = (w, h);
            batch.push(frame);
        }
        out.cameras.extend(batch[carried..].iter().map(|f| f.camera));
        out.moving.extend(batch[carried..].par_iter().map(moving).collect::<Vec<_>>());
        let first = from - carried;
        let pairs: Vec<_> = batch
            .par_windows(2)
            .enumerate()
            .map(|(i, pair)| {
                sparse_flow_pair([&pair[0], &pair[1]], flow)
                    .map_err(|source| TrackError::Flow { frame: first + i, source })
            })
            .collect();
        for pair in pairs {
            let [there, back] = pair?;
            out.forward.push(there);
            out.backward.push(back);
        }
        progress.update(PHASE, to, frames, "");
        last = batch.pop();
    }
    Ok(out)
}
