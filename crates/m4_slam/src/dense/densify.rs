//! The dense half from end to end.

use super::background::Background;
use super::bodies;
use super::config::DenseConfig;
use super::consistent;
use super::enlarge::{Small, enlarge};
use super::error::DenseError;
use super::flow::FlowPair;
use super::given::Given;
use super::ground::Ground;
use super::kept::{Placed, numbers};
use super::mono::Mono;
use super::motion::{self, Clues, Seen};
use super::moving_depth;
use super::plate;
use super::segment;
use super::shot::{Shot, sparse_points};
use super::smooth::Smoother;
use super::sources::Sources;
use super::static_depth::{self, Measured, Swept};
use super::tracks;
use super::working::WorkingFrame;
use crate::reconstruction::{CameraMotion, SparseReconstruction};
use m4_scene::{Camera, DepthMap, Mask, Plane, Progress, RgbImage, Tracks};
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

/// What [`densify`] finds.
#[derive(Debug, Clone, PartialEq)]
pub struct Dense {
    /// One a frame.
    pub frames: Vec<DenseFrame>,
    /// Points of what moves, followed through the clip, in the unit of the cameras; `None` where nothing could be followed
    /// or nobody asked.
    pub tracks: Option<Tracks>,
}

/// Sides below this, at the working size, have no neighbourhood of 5x5 pixels at half of it: long, thin pictures.
const LEAST_CONSISTENT: usize = 16;
/// How often depth and motion are estimated in turn.
const ROUNDS: usize = 2;
/// Fewer frames have no background that is seen most of the time.
const LEAST_BACKGROUND: usize = 8;

/// Everything in between.
#[cfg_attr(not(test), expect(dead_code, reason = "the measurements look at every stage"))]
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

/// Depth, motion masks and confidence for every frame and tracks of what moves, given cameras and tracks; `sources` measure
/// flow, outline what moves, and know depth.
///
/// # Errors
///
/// [`DenseError`] if frames and cameras do not fit, a setting is out of range, a source fails, or the user stopped it.
pub fn densify(
    frames: &[&RgbImage],
    sparse: &SparseReconstruction,
    sources: &Sources<'_>,
    given: &Given<'_>,
    config: &DenseConfig,
    progress: &dyn Progress,
) -> Result<Dense, DenseError> {
    let ground = Ground::of(frames, sparse, sources, given, config, progress)?;
    let (w, h) = ground.size;
    let (working, flows, placed) = match Placed::kept(sources.shelf, frames.len(), w * h) {
        Some(placed) => {
            let working = ground.working(frames, sparse, progress)?;
            let flows = ground.flows(&working, sources, progress)?;
            (working, flows, placed)
        }
        None => {
            let mut stages = estimate(&ground, frames, sparse, sources, given, config, progress)?;
            let placed = Placed::put(&mut stages, sources.shelf);
            let working = stages.shots.into_iter().map(|shot| shot.frame).collect();
            (working, stages.flows, placed)
        }
    };
    let tracks = followed(&ground, &working, &flows, &placed, config, progress)?;
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

/// Tracks of what moves.
fn followed(
    ground: &Ground,
    working: &[WorkingFrame],
    flows: &[FlowPair],
    placed: &Placed,
    config: &DenseConfig,
    progress: &dyn Progress,
) -> Result<Option<Tracks>, DenseError> {
    if !config.tracks.enabled {
        return Ok(None);
    }
    let cameras: Vec<Camera> = working.iter().map(|frame| frame.camera).collect();
    let clip = tracks::Clip {
        width: ground.size.0,
        height: ground.size.1,
        cameras: &cameras,
        moving: &placed.moving,
        disparity: &placed.disparity,
        flows,
    };
    tracks::tracks(&clip, &config.tracks, progress)
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

/// Everything but the enlargement.
#[cfg(test)]
pub(super) fn run(
    frames: &[&RgbImage],
    sparse: &SparseReconstruction,
    sources: &Sources<'_>,
    given: &Given<'_>,
    config: &DenseConfig,
    progress: &dyn Progress,
) -> Result<Stages, DenseError> {
    let ground = Ground::of(frames, sparse, sources, given, config, progress)?;
    estimate(&ground, frames, sparse, sources, given, config, progress)
}

fn estimate(
    ground: &Ground,
    frames: &[&RgbImage],
    sparse: &SparseReconstruction,
    sources: &Sources<'_>,
    given: &Given<'_>,
    config: &DenseConfig,
    progress: &dyn Progress,
) -> Result<Stages, DenseError> {
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
        Shot::new(&working, i, &points, &config.static_depth, parallax)
    })?;
    let swept = each(count, "sweeping depth", progress, |i| {
        let sweep = || static_depth::sweep(&shots, i, &config.static_depth).disparity;
        Swept {
            disparity: numbers(sources.shelf, &format!("swept-{i:05}"), w * h, sweep),
        }
    })?;
    // Made anew where needed: cheaper than keeping them.
    let smoother = |i: usize| Smoother::new(w, h, &shots[i].frame.rgb, config.static_depth.fill_sigma);
    let still = sparse.camera_motion == CameraMotion::Static && count >= LEAST_BACKGROUND;
    let clues = Clues {
        cameras: working.iter().map(|f| f.camera).collect(),
        verdicts: motion::verdicts(sparse, w, h),
        background: still.then(|| Background::new(&working)),
    };
    drop(working);

    // Motion spoils depth and depth shows motion: the second round knows the masks of the first.
    let told = given.masks.is_some();
    let mut moving: Option<Vec<Vec<u8>>> = (0..count).map(|i| given.mask(i, w, h)).collect();
    let mut last = None;
    for _ in 0..if told { 1 } else { ROUNDS } {
        let measured = each(count, "comparing depth", progress, |i| {
            let mut measured = static_depth::measure(&shots, &swept, moving.as_deref(), i, &config.static_depth);
            mono.impose(i, &mut measured, moving.as_ref().map(|m| m[i].as_slice()));
            measured
        })?;
        let filled = each(count, "filling depth", progress, |i| {
            if parallax {
                let moving = moving.as_ref().map(|m| m[i].as_slice());
                let measured = mono.with_prior(i, &measured[i], moving);
                static_depth::fill(&shots[i], &smoother(i), &measured, moving, &config.static_depth)
            } else {
                mono.without_parallax(i, w * h)
            }
        })?;
        let mut evidence = each(count, "finding motion", progress, |i| {
            let seen = Seen {
                frame: &shots[i].frame,
                disparity: &filled[i],
                confidence: &measured[i].confidence,
            };
            motion::evidence(&clues, &shots, &flows, i, &seen, &smoother(i), &config.motion)
        })?;
        for _ in 0..config.motion.votes {
            evidence = each(count, "voting on motion", progress, |i| {
                motion::vote(w, h, &evidence, &flows, i)
            })?;
        }
        if !told {
            moving = Some(each(count, "cutting masks", progress, |i| {
                motion::mask(w, h, &evidence[i], &config.motion)
            })?);
        }
        last = Some((measured, filled, evidence));
    }
    let (Some((mut measured, mut filled, evidence)), Some(mut moving)) = (last, moving) else {
        return Err(DenseError::NoFrames);
    };
    if parallax && !told {
        let near = each(count, "growing masks", progress, |i| {
            plate::grown(w, h, &moving[i], config.plate.guard_px)
        })?;
        filled = each(count, "filling depth", progress, |i| {
            let mut measured = mono.with_prior(i, &measured[i], Some(&near[i]));
            for (c, near) in measured.confidence.iter_mut().zip(&near[i]) {
                if *near > 0 {
                    *c = 0.0;
                }
            }
            static_depth::fill(&shots[i], &smoother(i), &measured, Some(&near[i]), &config.static_depth)
        })?;
        let scene = plate::Scene {
            width: w,
            height: h,
            cameras: &clues.cameras,
            shots: &shots,
            background: &filled,
            near: &near,
        };
        moving = each(count, "sharpening masks", progress, |i| {
            plate::sharpen(&scene, i, &moving[i], &smoother(i), &config.motion, &config.plate)
        })?;
    }
    if let (false, Some(segmenter)) = (told, sources.segmenter) {
        let sharp = each(count, "outlining moving parts", progress, |i| {
            segment::sharpen(segmenter, frames[i], (w, h), &moving[i], &config.segment)
                .map_err(|source| DenseError::Segment { frame: i, source })
        })?;
        moving = sharp.into_iter().collect::<Result<Vec<_>, _>>()?;
    }
    if parallax && !told {
        measured = each(count, "comparing depth", progress, |i| {
            let mut measured = static_depth::measure(&shots, &swept, Some(&moving), i, &config.static_depth);
            mono.impose(i, &mut measured, Some(&moving[i]));
            measured
        })?;
        filled = each(count, "filling depth", progress, |i| {
            let measured = mono.with_prior(i, &measured[i], Some(&moving[i]));
            static_depth::fill(
                &shots[i],
                &smoother(i),
                &measured,
                Some(&moving[i]),
                &config.static_depth,
            )
        })?;
    }
    let large = w.min(h) >= LEAST_CONSISTENT;
    if parallax && one_lens && large && config.consistent.enabled && count > 1 {
        let confidence: Vec<Vec<f32>> = measured.iter().map(|m| m.confidence.clone()).collect();
        let clip = consistent::Clip {
            width: w,
            height: h,
            cameras: &clues.cameras,
            flows: &flows,
            moving: &moving,
            confidence: &confidence,
        };
        let factors = consistent::factors(&clip, &filled, &config.consistent, progress, sources.shelf)?;
        for (filled, factors) in filled.iter_mut().zip(factors.into_iter().flatten()) {
            for (d, f) in filled.iter_mut().zip(factors) {
                *d *= f;
            }
        }
    }
    let mut disparity = moving_depth::place(w, h, &moving, &filled, &flows, &config.moving_depth);
    if parallax && one_lens {
        let clip = bodies::Clip {
            width: w,
            height: h,
            cameras: &clues.cameras,
            moving: &moving,
            background: &filled,
            flows: &flows,
        };
        bodies::place(
            &clip,
            smoother,
            &config.moving_depth,
            &config.bodies,
            &mut disparity,
            progress,
        )?;
    }
    for i in 0..count {
        if parallax {
            mono.place_moving(i, &measured[i], &filled[i], &moving[i], &mut disparity[i]);
        }
        mono.overrule(i, &mut disparity[i]);
    }
    Ok(Stages {
        width: w,
        height: h,
        shots,
        flows,
        swept,
        measured,
        filled,
        evidence,
        moving,
        disparity,
    })
}
