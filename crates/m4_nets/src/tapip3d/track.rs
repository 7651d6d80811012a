//! All queries through all frames.

use super::Tapip3d;
use super::clip::{PointQuery, PointTracks, PosedClip, Tapip3dOptions};
use super::frame::{Sides, map_sizes};
use super::pass::{FrameOrder, Frames, TrackedPoint, walk};
use super::source::Source;
use crate::NetError;
use crate::error::refuse;
use m4_core::Progress;
use std::collections::BTreeMap;

/// Queries of a group by their frames: their numbers, and where they are.
pub type Group = BTreeMap<usize, (Vec<usize>, Vec<[f32; 3]>)>;

/// Fewest queries of a group, whatever memory may hold.
const FEWEST: usize = 64;
/// Longest side of frames.
const LONGEST: usize = 1 << 13;

/// Points that begin in the same frame, and what is known of them.
#[derive(Debug, Clone)]
pub struct Batch {
    /// Their queries; none for those of the grid.
    pub queries: Vec<usize>,
    pub points: Vec<[f32; 3]>,
    pub sides: Sides,
}

/// What is known of all points.
#[derive(Debug)]
pub struct TrackState {
    /// Frames of the clip.
    pub frames: usize,
    /// A group's own, by frames.
    pub groups: Vec<BTreeMap<usize, Batch>>,
    /// The grids of the first and the last frame, for the forward and the backward pass.
    pub grids: [Option<Batch>; 2],
}

impl TrackState {
    /// Those of a group that begin at a time.
    pub fn batches_at<'a>(
        &'a self,
        group: &'a BTreeMap<usize, Batch>,
        order: FrameOrder,
        time: usize,
    ) -> impl Iterator<Item = &'a Batch> {
        let grid = self.grids[usize::from(order.backward)]
            .as_ref()
            .filter(|_| time == 0);
        grid.into_iter().chain(group.get(&order.frame(time)))
    }
}

/// As [`Tapip3d::track`], with the depths that count where they are known.
pub fn track_within(
    net: &Tapip3d,
    clip: &dyn PosedClip,
    queries: &[PointQuery],
    options: &Tapip3dOptions,
    range: Option<[f32; 2]>,
    progress: &dyn Progress,
) -> Result<PointTracks, NetError> {
    check_size(net, options)?;
    let frames = clip.frames();
    let source = Source::new(net, clip, options)?;
    let points = points(&source, queries, frames)?;
    if queries.is_empty() {
        return Ok(PointTracks {
            frames,
            world: Vec::new(),
            visibility: Vec::new(),
        });
    }
    let range = match range {
        Some(range) => range,
        None => source.range(progress)?,
    };
    let groups = grouped(queries, &points, together(&source));
    let mut state = TrackState {
        frames,
        groups: vec![BTreeMap::new(); groups.len()],
        grids: [None, None],
    };
    let most = options.memory_bytes / 2 / source.frame_bytes().max(1);
    let mut held = Frames::new(most.max(net.config.window));
    let order = |backward| FrameOrder {
        frames,
        backward,
        window: net.config.window,
    };
    let back = options.backward && queries.iter().any(|q| q.frame > 0);
    let total = order(false).starts().count() * groups.len() * (1 + usize::from(back));
    let mut done = 0;
    let mut tracks = PointTracks {
        frames,
        world: points
            .iter()
            .flat_map(|&p| std::iter::repeat_n(p, frames))
            .collect(),
        visibility: vec![0.0; queries.len() * frames],
    };
    for backward in [false, true] {
        if backward && !back {
            break;
        }
        let report = || {
            done += 1;
            progress.update("points tracked", done, total, "");
        };
        let walkers = walk(
            &source,
            order(backward),
            range,
            &mut state,
            &groups,
            &mut held,
            report,
            progress,
        )?;
        for walker in walkers.iter().flatten() {
            enter(&mut tracks, walker, queries, order(backward));
        }
    }
    for p in &mut tracks.world {
        *p = [0, 1, 2].map(|axis| (f64::from(p[axis]) + source.origin[axis]) as f32);
    }
    Ok(tracks)
}

/// Gives `tracks` what a pass found of a point: forward from its frame on, backward before it.
fn enter(
    tracks: &mut PointTracks,
    walker: &TrackedPoint,
    queries: &[PointQuery],
    order: FrameOrder,
) {
    let Some(query) = walker.query else { return };
    let begins = queries[query].frame;
    let frames = if order.backward {
        0..begins
    } else {
        begins..order.frames
    };
    for frame in frames {
        let (to, time) = (query * order.frames + frame, order.time(frame));
        tracks.world[to] = walker.at[time];
        tracks.visibility[to] = 1.0 / (1.0 + (-walker.logits[time]).exp());
    }
}

fn check_size(net: &Tapip3d, options: &Tapip3dOptions) -> Result<(), NetError> {
    let (width, height) = options.size;
    let coarsest = map_sizes(options.size, net.config.levels).pop();
    let points = coarsest.map_or(0, |(w, h)| w.saturating_mul(h));
    let neighbours = net.config.neighbours;
    if points < neighbours || width > LONGEST || height > LONGEST {
        return refuse(format!(
            "points cannot be tracked at {width} x {height} px: the coarsest map has to hold {neighbours} points, which takes \
             32 by 32 px for each; choose a larger size"
        ));
    }
    Ok(())
}

/// Where queries are about the origin.
fn points(
    source: &Source<'_>,
    queries: &[PointQuery],
    frames: usize,
) -> Result<Vec<[f32; 3]>, NetError> {
    let point = |(index, query): (usize, &PointQuery)| {
        let bad = |reason: String| refuse(format!("point {index} cannot be tracked: {reason}"));
        if query.frame >= frames {
            return bad(format!(
                "it is asked for in frame {} of {frames}",
                query.frame
            ));
        }
        let p = [0, 1, 2].map(|axis| (query.world[axis] - source.origin[axis]) as f32);
        if p.iter().all(|x| x.is_finite()) {
            Ok(p)
        } else {
            bad(format!("it is asked for at {:?}", query.world))
        }
    };
    queries.iter().enumerate().map(point).collect()
}

/// How many queries are followed together.
fn together(source: &Source<'_>) -> usize {
    let (sizes, config) = (&source.net.sizes, &source.net.config);
    let number = source.net.net.encoder.dtype().size();
    // of the updater: tokens, their norms, queries, keys, values, what was found, and its input; of
    // queries: tokens and their queries, keys and values
    let updater = config.window * (10 * sizes.hidden + 3 * sizes.input);
    let sides = config.levels * (1 + config.neighbours) * 5 * sizes.tokens;
    let most = source.options.memory_bytes / 2 / ((updater + sides) * number).max(1);
    let grid = source
        .options
        .support_grid
        .saturating_mul(source.options.support_grid);
    most.saturating_sub(grid).max(FEWEST)
}

/// Queries in groups of at most `most`, dealt out one by one, so that each group sees the whole
/// scene.
fn grouped(queries: &[PointQuery], points: &[[f32; 3]], most: usize) -> Vec<Group> {
    let count = queries.len().div_ceil(most);
    let mut groups = vec![Group::new(); count];
    for (i, (query, &p)) in queries.iter().zip(points).enumerate() {
        let (numbers, points) = groups[i % count].entry(query.frame).or_default();
        numbers.push(i);
        points.push(p);
    }
    groups
}
