//! Points of moving parts followed along the flow and lifted with their depth.
//!
//! ```text
//! grid of moving pixels without a track -> chain there and back in time -> depth of each place -> world
//!                                    cut at jumps, smoothed -> carried on where hidden (`fill`) -> Tracks
//! ```
//!
//! docs/spec/front-end.md 7.1, item 8 ("3D tracks by flow chaining + lifting"), which is the substitute of its
//! section 3 for a network that tracks: [`crate::tracks`] with the flow and the depth that this stage has anyway. A chain ends where the
//! flow does not lead back, where it leaves the image and where it leaves the masks; with `fill` the point goes on with its
//! neighbours, else what went behind something comes out as another track.
//!
//! Pixels here are those of the working size, with the centre of the first one at 0, 0, as [`Camera::unproject`] has them.

use super::DenseError;
use super::flow::FlowPair;
use crate::tracks::{
    QueryGrid, Scene, Sparse, Strip, TrackConfig, TrackError, board_of, fill, followed, on_grid, sparse_flow,
};
use m4_core::{Camera, Plane, Progress, Tracks};

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

/// Tracks of everything that moves; `None` if nothing could be followed.
pub(super) fn tracks(
    clip: &Clip<'_>,
    grid: &QueryGrid,
    config: &TrackConfig,
    progress: &dyn Progress,
) -> Result<Option<Tracks>, DenseError> {
    let strip = strip(clip);
    let pieces = on_grid(&strip, grid, config);
    if pieces.is_empty() {
        return Ok(None);
    }
    let (mut board, queries) = board_of(clip.moving.len(), &pieces);
    let surface = |i: usize| {
        let depth = |x: usize, y: usize| 1.0 / clip.disparity[i][y * clip.width + x];
        Ok(Plane::from_fn(clip.width, clip.height, depth))
    };
    let scene = Scene {
        strip: &strip,
        surface: &surface,
        config,
    };
    if config.fill {
        fill(&scene, &mut board, progress).map_err(|e| match e {
            TrackError::Cancelled { phase } => DenseError::Cancelled { phase },
            other => DenseError::Tracks(other),
        })?;
    }
    Ok(Some(followed(board, queries)?.tracks))
}

/// What is kept of the clip.
fn strip(clip: &Clip<'_>) -> Strip {
    let (w, h) = (clip.width, clip.height);
    let moves = |frame: usize, i: usize| clip.moving[frame][i] > 0;
    let moving = |frame: usize| Sparse::new(w, h, |i| moves(frame, i).then(|| clip.disparity[frame][i]));
    let pairs = || clip.flows.iter().enumerate();
    Strip {
        width: w,
        height: h,
        cameras: clip.cameras.to_vec(),
        moving: (0..clip.moving.len()).map(moving).collect(),
        forward: pairs()
            .map(|(t, pair)| sparse_flow(&pair.forward, &pair.forward_round_trip, |i| moves(t, i)))
            .collect(),
        backward: pairs()
            .map(|(t, pair)| sparse_flow(&pair.backward, &pair.backward_round_trip, |i| moves(t + 1, i)))
            .collect(),
    }
}

#[cfg(test)]
#[path = "tracks_tests.rs"]
mod tests;
