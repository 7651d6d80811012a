//! The dense half from end to end.

use super::background::Background;
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
use super::static_depth::{self, Swept};
use super::tracks;
use super::user_masks;
use crate::classical::reconstruction::{CameraMotion, SparseReconstruction};
use crate::resample::rgb_and_grey;
use crate::tracks::{QueryGrid, TrackConfig};
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

/// Depth and motion of a clip at the size of its frames.
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

/// Depth and motion of a clip at the working size, which [`enlarge`](Self::enlarge) brings to the size of the frames.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Estimate {
    size: (usize, usize),
    /// One over z-depth, `[frames][height][width]`.
    disparity: Vec<Vec<f32>>,
    /// How far the depth was measured, 0..1, `[frames][height][width]`.
    confidence: Vec<Vec<f32>>,
    /// Above 0 in dynamic regions, `[frames][height][width]`.
    moving: Vec<Vec<u8>>,
    tracks: Option<Tracks>,
}

/// Everything but tracks.
struct WorkingResult {
    cameras: Vec<Camera>,
    flows: Vec<FlowPair>,
    confidence: Vec<Vec<f32>>,
    moving: Vec<Vec<u8>>,
    disparity: Vec<Vec<f32>>,
}

/// Estimates depth, motion masks and confidence of every frame and tracks of dynamic objects, given cameras and feature tracks, with the
/// methods of `sources`. `masks` has one mask per frame, of any size, above 0 in dynamic regions; motion is not estimated then.
///
/// # Errors
///
/// [`DenseError`] if frames and cameras do not fit, a setting is out of range, a source fails, or the user stopped it.
pub fn estimate(
    frames: &[&RgbImage],
    sparse: &SparseReconstruction,
    sources: &Sources<'_>,
    masks: Option<&[Mask]>,
    config: &DenseConfig,
    progress: &dyn Progress,
) -> Result<Estimate, DenseError> {
    let ground = Ground::of(frames, sparse, sources, masks, config, progress)?;
    let found = stages(&ground, frames, sparse, sources, masks, progress)?;
    let tracks = if config.tracks {
        let clip = tracks::Clip {
            width: ground.size.0,
            height: ground.size.1,
            cameras: &found.cameras,
            moving: &found.moving,
            disparity: &found.disparity,
            flows: &found.flows,
        };
        tracks::tracks(&clip, &QueryGrid::chains(), &TrackConfig::default(), progress)?
    } else {
        None
    };
    Ok(Estimate {
        size: ground.size,
        disparity: found.disparity,
        confidence: found.confidence,
        moving: found.moving,
        tracks,
    })
}

impl Estimate {
    /// Returns depth, masks and confidence at the size of `frames`, those that the estimate was made of.
    ///
    /// # Errors
    ///
    /// [`DenseError`] for another number of frames, or if the user stopped it.
    pub fn enlarge(self, frames: &[&RgbImage], progress: &dyn Progress) -> Result<Dense, DenseError> {
        if frames.len() != self.disparity.len() {
            return Err(DenseError::Given {
                what: "estimated depth",
                found: self.disparity.len(),
                expected: frames.len(),
            });
        }
        let (width, height) = self.size;
        let frames = each(frames.len(), "enlarging depth", progress, |i| {
            let small = Small {
                size: self.size,
                rgb: &rgb_and_grey(frames[i], width, height).0,
                disparity: &self.disparity[i],
                moving: &self.moving[i],
                confidence: &self.confidence[i],
            };
            enlarge(frames[i], &small)
        })?;
        Ok(Dense {
            frames,
            tracks: self.tracks,
        })
    }
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

fn stages(
    ground: &Ground,
    frames: &[&RgbImage],
    sparse: &SparseReconstruction,
    sources: &Sources<'_>,
    masks: Option<&[Mask]>,
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
    let swept: Vec<Swept> = each(count, "sweeping depth", progress, |i| static_depth::sweep(&shots, i))?;
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
    let told = masks.map(|masks| masks.iter().map(|mask| user_masks::at_size(mask, w, h)).collect());
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
        cameras: clues.cameras,
        flows,
        confidence: measured.into_iter().map(|measured| measured.confidence).collect(),
        moving,
        disparity,
    })
}
