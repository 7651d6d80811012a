//! The dense half from end to end.

use super::background::Background;
use super::cached::{CachedDepth, numbers};
use super::config::DenseConfig;
use super::enlarge::{Small, enlarge};
use super::error::DenseError;
use super::flow::FlowPair;
use super::ground::Ground;
use super::layers;
use super::mono::Mono;
use super::motion::{self, MotionCues};
use super::motion_segmentation::{self, MotionSegmentation};
use super::moving_depth;
use super::rigid_objects;
use super::shot::{Shot, sparse_points};
use super::sources::Sources;
use super::static_depth::{self, Measured, Swept};
use super::tracks;
use super::user_masks::UserMasks;
use super::working::WorkingFrame;
use crate::reconstruction::{CameraMotion, SparseReconstruction};
use crate::tracks3d::{QueryGrid, TrackConfig};
use m4_core::{Camera, DepthMap, Mask, Plane, Progress, RgbImage, Tracks};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Depth and motion of one frame, all of the size of the frame.
#[derive(Debug, Clone, PartialEq)]
pub struct DenseFrame {
    /// z-depth in the unit of the cameras, finite and above 0 everywhere.
    pub depth: DepthMap,
    /// 255 where the pixel shows something that moves, else 0.
    pub mask: Mask,
    /// How far the depth was measured and not made up, 0..1.
    pub confidence: Plane<f32>,
}

/// What [`estimate_depth`] finds.
#[derive(Debug, Clone, PartialEq)]
pub struct Dense {
    /// One per frame.
    pub frames: Vec<DenseFrame>,
    /// Dynamic points, tracked through the clip, in the unit of the cameras; `None` where nothing could be tracked
    /// or tracks are disabled.
    pub tracks: Option<Tracks>,
}

/// Fewer frames have no background that is seen most of the time.
const LEAST_BACKGROUND: usize = 8;

/// The result at the working size, before enlargement.
pub(super) struct WorkingResult {
    pub shots: Vec<Shot>,
    pub flows: Vec<FlowPair>,
    pub measured: Vec<Measured>,
    pub moving: Vec<Vec<u8>>,
    pub disparity: Vec<Vec<f32>>,
}

/// Depth, motion masks and confidence for every frame and tracks of dynamic objects, given cameras and tracks; `sources` measure
/// flow, segment dynamic regions, and provide depth.
///
/// # Errors
///
/// [`DenseError`] if frames and cameras do not fit, a setting is out of range, a source fails, or the user stopped it.
pub fn estimate_depth(
    frames: &[&RgbImage],
    sparse: &SparseReconstruction,
    sources: &Sources<'_>,
    given: &UserMasks<'_>,
    config: &DenseConfig,
    progress: &dyn Progress,
) -> Result<Dense, DenseError> {
    let ground = Ground::of(frames, sparse, sources, given, config, progress)?;
    let (w, h) = ground.size;
    let (working, flows, placed) = match CachedDepth::load(sources.cache, frames.len(), w * h) {
        Some(placed) => {
            let working = ground.working(frames, sparse, progress)?;
            let flows = ground.flows(&working, sources, progress)?;
            (working, flows, placed)
        }
        None => {
            let mut stages = estimate(&ground, frames, sparse, sources, given, progress)?;
            let placed = CachedDepth::store(&mut stages, sources.cache);
            let working = stages.shots.into_iter().map(|shot| shot.frame).collect();
            (working, stages.flows, placed)
        }
    };
    let tracks = if config.tracks {
        followed(&ground, &working, &flows, &placed, progress)?
    } else {
        None
    };
    let frames = each(frames.len(), "enlarging depth", progress, |i| {
        let small = Small {
            frame: &working[i],
            disparity: &placed.disparity[i],
            moving: &placed.moving[i],
            confidence: &placed.confidence[i],
        };
        enlarge(frames[i], &small)
    })?;
    Ok(Dense { frames, tracks })
}

/// Tracks of dynamic points.
fn followed(
    ground: &Ground,
    working: &[WorkingFrame],
    flows: &[FlowPair],
    placed: &CachedDepth,
    progress: &dyn Progress,
) -> Result<Option<Tracks>, DenseError> {
    let cameras: Vec<Camera> = working.iter().map(|frame| frame.camera).collect();
    let clip = tracks::Clip {
        width: ground.size.0,
        height: ground.size.1,
        cameras: &cameras,
        moving: &placed.moving,
        disparity: &placed.disparity,
        flows,
    };
    tracks::tracks(&clip, &QueryGrid::chains(), &TrackConfig::default(), progress)
}

/// Runs `f` for every frame in parallel, in order of frames, with progress.
pub(super) fn each<T: Send>(
    count: usize,
    phase: &'static str,
    progress: &dyn Progress,
    f: impl Fn(usize) -> T + Sync,
) -> Result<Vec<T>, DenseError> {
    let done = AtomicUsize::new(0);
    let one = |i: usize| {
        if progress.cancelled() {
            return None;
        }
        let out = f(i);
        progress.update(phase, done.fetch_add(1, Ordering::Relaxed) + 1, count, "");
        Some(out)
    };
    let all: Option<Vec<T>> = (0..count).into_par_iter().map(one).collect();
    all.ok_or(DenseError::Cancelled { phase })
}

fn estimate(
    ground: &Ground,
    frames: &[&RgbImage],
    sparse: &SparseReconstruction,
    sources: &Sources<'_>,
    given: &UserMasks<'_>,
    progress: &dyn Progress,
) -> Result<WorkingResult, DenseError> {
    let (count, (w, h)) = (frames.len(), ground.size);
    let (parallax, one_lens) = (ground.parallax, ground.one_lens);
    let mono = each(count, "reading depth", progress, |i| {
        Mono::read(sources.mono, i, frames[i], (w, h)).map_err(|source| DenseError::Mono { frame: i, source })
    })?;
    let mono = Mono::of(mono.into_iter().collect::<Result<Vec<_>, _>>()?);
    let working = ground.working(frames, sparse, progress)?;
    let flows = ground.flows(&working, sources, progress)?;
    let points = sparse_points(sparse, w, h);
    let shots = each(count, "preparing frames", progress, |i| {
        Shot::new(&working, i, &points, parallax)
    })?;
    let swept = each(count, "sweeping depth", progress, |i| {
        let sweep = || static_depth::sweep(&shots, i).disparity;
        Swept {
            disparity: numbers(sources.cache, &format!("swept-{i:05}"), w * h, sweep),
        }
    })?;
    let still = sparse.camera_motion == CameraMotion::Static && count >= LEAST_BACKGROUND;
    let clues = MotionCues {
        cameras: working.iter().map(|f| f.camera).collect(),
        verdicts: motion::verdicts(sparse, w, h),
        background: still.then(|| Background::new(&working)),
    };
    drop(working);
    let clip = motion_segmentation::Clip {
        width: w,
        height: h,
        parallax,
        frames,
        shots: &shots,
        swept: &swept,
        flows: &flows,
        mono: &mono,
        clues: &clues,
        sources,
        progress,
    };
    let told = (0..count).map(|i| given.mask(i, w, h)).collect();
    let MotionSegmentation {
        moving,
        measured,
        filled,
    } = clip.segment_motion(told)?;
    let input = rigid_objects::Clip {
        width: w,
        height: h,
        cameras: &clues.cameras,
        moving: &moving,
        background: &filled,
        flows: &flows,
    };
    let mut disparity = if parallax || !mono.is_empty() {
        moving_depth::place(w, h, &moving, &filled, &flows)
    } else {
        layers::place(&input, &shots)
    };
    if parallax && one_lens {
        rigid_objects::place(&input, |i| clip.smoother(i), true, &mut disparity, progress)?;
    }
    for i in 0..count {
        if parallax {
            mono.place_moving(i, &measured[i], &filled[i], &moving[i], &mut disparity[i]);
        }
        mono.overrule(i, &mut disparity[i]);
    }
    Ok(WorkingResult {
        shots,
        flows,
        measured,
        moving,
        disparity,
    })
}
