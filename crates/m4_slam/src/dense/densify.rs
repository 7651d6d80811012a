//! The dense half from end to end.

use super::config::DenseConfig;
use super::error::DenseError;
use super::flow::{Flow, Pyramid, flow, round_trip_px};
use super::motion;
use super::moving_depth;
use super::shot::{Shot, sparse_points};
use super::smooth::Smoother;
use super::static_depth::{self, Measured, Swept};
use super::working::{WorkingFrame, working_size};
use crate::reconstruction::{CameraMotion, SparseReconstruction};
use m4_scene::{Camera, DepthMap, Mask, Plane, Progress, RgbImage};
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

/// Least side of a frame, pixels.
const LEAST_SIDE: usize = 32;

/// Flow between a frame and the next, both ways.
pub(super) struct FlowPair {
    pub forward: Flow,
    pub backward: Flow,
    pub forward_round_trip: Vec<f32>,
    pub backward_round_trip: Vec<f32>,
}

/// Everything in between, for the tests to look at.
pub(super) struct Stages {
    pub width: usize,
    pub height: usize,
    pub shots: Vec<Shot>,
    pub flows: Vec<FlowPair>,
    pub swept: Vec<Swept>,
    pub measured: Vec<Measured>,
    pub filled: Vec<Vec<f32>>,
    pub evidence: Vec<Vec<f32>>,
    pub moving: Vec<Vec<u8>>,
    pub disparity: Vec<Vec<f32>>,
}

/// Depth, motion masks and confidence for every frame, given cameras and tracks.
///
/// # Errors
///
/// [`DenseError`] if frames and cameras do not fit, a setting is out of range, or the user stopped it.
pub fn densify(
    frames: &[&RgbImage],
    sparse: &SparseReconstruction,
    config: &DenseConfig,
    progress: &dyn Progress,
) -> Result<Vec<DenseFrame>, DenseError> {
    let stages = run(frames, sparse, config, progress)?;
    let (w, h) = (stages.width, stages.height);
    let out = (0..frames.len()).into_par_iter().map(|i| {
        let (fw, fh) = frames[i].size();
        let at = |x: usize, y: usize| ((2 * y + 1) * h / (2 * fh)) * w + (2 * x + 1) * w / (2 * fw);
        DenseFrame {
            depth: Plane::from_fn(fw, fh, |x, y| 1.0 / stages.disparity[i][at(x, y)]),
            mask: Plane::from_fn(fw, fh, |x, y| stages.moving[i][at(x, y)]),
            confidence: Plane::from_fn(fw, fh, |x, y| stages.measured[i].confidence[at(x, y)]),
        }
    });
    Ok(out.collect())
}

fn check(frames: &[&RgbImage], sparse: &SparseReconstruction) -> Result<(usize, usize), DenseError> {
    let first = frames.first().ok_or(DenseError::NoFrames)?.size();
    if frames.len() != sparse.cameras.len() {
        return Err(DenseError::Count {
            frames: frames.len(),
            cameras: sparse.cameras.len(),
        });
    }
    for (frame, image) in frames.iter().enumerate() {
        let found = image.size();
        if found != first || found.0.min(found.1) < LEAST_SIDE {
            return Err(DenseError::Size {
                frame,
                found,
                expected: first,
                minimum: LEAST_SIDE,
            });
        }
    }
    for (frame, camera) in sparse.cameras.iter().enumerate() {
        let k = &camera.intrinsics;
        let finite = |v: &[f64]| v.iter().all(|v| v.is_finite());
        let pose = &camera.c2w;
        let what = if k.width == 0 || k.height == 0 {
            "an empty image"
        } else if !finite(&[k.fx, k.fy, k.cx, k.cy]) || k.fx <= 0.0 || k.fy <= 0.0 {
            "no valid focal length"
        } else if !finite(pose.rotation.as_slice()) || !finite(pose.translation.as_slice()) {
            "a pose that is not finite"
        } else {
            continue;
        };
        return Err(DenseError::Camera { frame, what });
    }
    Ok(first)
}

/// Runs `f` for every frame in parallel, in order of frames, with progress.
fn each<T: Send>(
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

pub(super) fn run(
    frames: &[&RgbImage],
    sparse: &SparseReconstruction,
    config: &DenseConfig,
    progress: &dyn Progress,
) -> Result<Stages, DenseError> {
    config.check()?;
    let (full_w, full_h) = check(frames, sparse)?;
    let (w, h) = working_size(full_w, full_h, config.working_side_px);
    let count = frames.len();
    let parallax = sparse.camera_motion == CameraMotion::Parallax;
    let working = each(count, "shrinking frames", progress, |i| {
        WorkingFrame::new(frames[i], &sparse.cameras[i], w, h)
    })?;
    let points = sparse_points(sparse, w, h);
    let shots = each(count, "preparing frames", progress, |i| {
        Shot::new(&working, i, &points, &config.static_depth, parallax)
    })?;
    let flows = each(count.saturating_sub(1), "computing flow", progress, |i| {
        let pyramid = |i: usize| Pyramid::new(w, h, &working[i].grey);
        let (a, b) = (pyramid(i), pyramid(i + 1));
        let (forward, backward) = (flow(&a, &b, &config.flow), flow(&b, &a, &config.flow));
        FlowPair {
            forward_round_trip: round_trip_px(&forward, &backward),
            backward_round_trip: round_trip_px(&backward, &forward),
            forward,
            backward,
        }
    })?;
    let swept = each(count, "sweeping depth", progress, |i| static_depth::sweep(&shots, i, &config.static_depth))?;
    let smoothers: Vec<Smoother> = each(count, "reading edges", progress, |i| {
        Smoother::new(w, h, &shots[i].frame.rgb, config.static_depth.fill_sigma)
    })?;
    let cameras: Vec<Camera> = working.iter().map(|f| f.camera).collect();
    let verdicts = motion::verdicts(sparse, w, h);
    let mut moving: Option<Vec<Vec<u8>>> = None;
    let mut rounds = None;
    for _ in 0..2 {
        let measured = each(count, "comparing depth", progress, |i| {
            static_depth::measure(&shots, &swept, moving.as_deref(), i, &config.static_depth)
        })?;
        let filled = each(count, "filling depth", progress, |i| {
            static_depth::fill(&shots[i], &smoothers[i], &measured[i], &config.static_depth)
        })?;
        let mut evidence = each(count, "finding motion", progress, |i| {
            let (depth, tracks) = (&filled[i], &verdicts[i]);
            motion::evidence(&cameras, &flows, i, depth, &measured[i], tracks, &smoothers[i], &config.motion)
        })?;
        for _ in 0..config.motion.votes {
            evidence = each(count, "voting on motion", progress, |i| motion::vote(w, h, &evidence, &flows, i))?;
        }
        let masks = each(count, "cutting masks", progress, |i| motion::mask(w, h, &evidence[i], &config.motion))?;
        moving = Some(masks);
        rounds = Some((measured, filled, evidence));
    }
    let (Some((measured, filled, evidence)), Some(moving)) = (rounds, moving) else {
        return Err(DenseError::NoFrames);
    };
    let touched = each(count, "placing moving parts", progress, |i| {
        moving_depth::touch(w, h, &moving[i], &filled[i], &config.moving_depth)
    })?;
    let disparity = moving_depth::steady(w, h, &moving, &touched, &filled, &flows, &config.moving_depth);
    Ok(Stages {
        width: w,
        height: h,
        shots,
        flows,
        swept,
        measured,
        disparity,
        filled,
        evidence,
        moving,
    })
}
