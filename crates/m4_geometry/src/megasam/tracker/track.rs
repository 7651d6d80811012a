//! The whole way from frames to the geometry of all of them; frames between keyframes get a pose by
//! interpolation, refined against the neighbouring keyframes.

use super::TrackerSettings;
use super::backend::Backend;
use super::correspondence::{Correspondence, TrackerError, check_count};
use super::frontend::Frontend;
use super::keyframes::{FrameInput, Keyframes, Update};
use crate::dba::{DbaOptions, Free, Geometry, Grid, Observability, Pinhole};
use crate::megasam::graph::FactorGraph;
use m4_core::{Progress, Se3};

/// Weight of the depth prior of the probe: 1e-5.
const PROBE_ALPHA: f64 = 1e-5;

/// What a clip looks like to the tracker.
#[derive(Debug, Clone, Copy)]
pub struct TrackerInput<'a> {
    /// Size of all planes.
    pub grid: Grid,
    /// First guess.
    pub lens: Pinhole<f64>,
    /// All frames, in order of time.
    pub frames: &'a [FrameInput],
}

/// The geometry of a clip; lists are `[frames]`.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct Tracked {
    /// World to camera, disparities and lens, in the tracker's conventions ([`crate::dba`]). The
    /// first camera is the origin.
    pub geometry: Geometry<f32>,
    /// Probability that each pixel is static, `[frames][height * width]`, 0..=1.
    pub static_confidence: Vec<Vec<f32>>,
    /// What the keyframes could tell.
    pub observability: Observability,
    /// True if the focal length was adjusted.
    pub focal_adjusted: bool,
    /// Frames that were keyframes.
    pub keyframes: Vec<usize>,
    /// Root mean square of the weighted residuals at the end, pixels of the grid.
    pub rms_px: f64,
}

impl Tracked {
    /// Camera to world, the library's convention.
    #[must_use]
    pub fn c2w(&self) -> Vec<Se3<f64>> {
        self.geometry.poses.iter().map(Se3::inverse).collect()
    }
}

/// Front end, observability probe, back end, filler, final adjustment of all frames.
///
/// A clip with fewer keyframes than the warm-up asks for is initialised with those there are.
///
/// # Errors
///
/// [`TrackerError`] for too few frames, frames out of order, failing correspondences, a useless
/// state, or when the user stops.
pub fn track(
    clip: &TrackerInput<'_>,
    source: &mut dyn Correspondence,
    settings: &TrackerSettings,
    progress: &dyn Progress,
) -> Result<Tracked, TrackerError> {
    check(clip)?;
    let total = clip.frames.len();
    let mut frontend = Frontend::new(clip.grid, clip.lens, *settings);
    for (k, frame) in clip.frames.iter().enumerate() {
        if progress.cancelled() {
            return Err(TrackerError::Cancelled);
        }
        frontend.submit(frame, k + 1 == total, source)?;
        let note = format!("{} keyframes", frontend.keyframes.len());
        progress.update("tracking", k + 1, total, &note);
    }
    if !frontend.is_initialised() {
        frontend.initialise(source)?;
    }
    let mut keyframes = frontend.finish(source)?;
    let observability = probe(&keyframes, source, settings, progress)?;
    let focal_adjusted = settings.optimise_focal && observability.focal_is_seen();
    let alpha = observability.prior_alpha(settings.low_parallax_alpha);
    let mut backend = Backend::new(&keyframes, *settings);
    let updates = settings.backend_updates;
    backend.run(
        &mut keyframes,
        source,
        updates,
        focal_adjusted,
        alpha,
        progress,
    )?;
    backend.finish(source)?;

    let poses = fill(&keyframes, clip.frames, settings, source, progress)?;
    let mut all = everything(&keyframes, clip.frames, &poses);
    let mut backend = Backend::new(&all, *settings);
    let report = backend.run(
        &mut all,
        source,
        settings.final_updates,
        false,
        alpha,
        progress,
    )?;
    let static_confidence = backend.static_confidence(&all);
    backend.finish(source)?;
    Ok(Tracked {
        geometry: all.geometry,
        static_confidence,
        observability,
        focal_adjusted,
        keyframes: keyframes.frame,
        rms_px: report.rms_px,
    })
}

fn check(clip: &TrackerInput<'_>) -> Result<(), TrackerError> {
    check_count(clip.frames.len())?;
    for pair in clip.frames.windows(2) {
        // written so that a NaN fails
        if !(pair[1].time_s > pair[0].time_s && pair[1].frame > pair[0].frame) {
            return Err(TrackerError::Input(format!(
                "frame {} is at {} s, not after the frame before it; give frames in order of time",
                pair[1].frame, pair[1].time_s
            )));
        }
    }
    Ok(())
}

/// Adjusts a copy with next to no prior and measures what it can tell.
fn probe(
    keyframes: &Keyframes,
    source: &mut dyn Correspondence,
    settings: &TrackerSettings,
    progress: &dyn Progress,
) -> Result<Observability, TrackerError> {
    let mut copy = keyframes.clone();
    let mut backend = Backend::new(&copy, *settings);
    backend.run(
        &mut copy,
        source,
        settings.probe_updates,
        false,
        Some(PROBE_ALPHA),
        progress,
    )?;
    let observability = backend.observability(&copy)?;
    backend.finish(source)?;
    Ok(observability)
}

/// All frames: adjusted depth where there is some, otherwise that of the sensor.
fn everything(keyframes: &Keyframes, frames: &[FrameInput], poses: &[Se3<f64>]) -> Keyframes {
    let mut all = Keyframes::new(keyframes.geometry.grid, keyframes.geometry.lens);
    for (input, pose) in frames.iter().zip(poses) {
        let like = all.len().checked_sub(1);
        all.push(input, *pose, like);
        let at = all.len() - 1;
        if let Some(k) = keyframes.frame.iter().position(|&f| f == input.frame) {
            all.geometry.disparity[at].clone_from(&keyframes.geometry.disparity[k]);
            all.damping[at].clone_from(&keyframes.damping[k]);
        }
    }
    all
}

/// Frames that are placed at once: 16.
const BATCH: usize = 16;

/// The pose of every frame of `frames`, world to camera: that of the keyframe, or one placed
/// between its neighbours. Depth and poses of the keyframes stay as they are.
///
/// # Errors
///
/// [`TrackerError`] when correspondences fail or the user stops.
pub fn fill(
    keyframes: &Keyframes,
    frames: &[FrameInput],
    settings: &TrackerSettings,
    source: &mut dyn Correspondence,
    progress: &dyn Progress,
) -> Result<Vec<Se3<f64>>, TrackerError> {
    let count = keyframes.len();
    let mut poses: Vec<Option<Se3<f64>>> = frames
        .iter()
        .map(|f| {
            let keyframe = keyframes.frame.iter().position(|&k| k == f.frame);
            keyframe.map(|k| keyframes.geometry.poses[k])
        })
        .collect();
    let missing: Vec<usize> = (0..frames.len()).filter(|&k| poses[k].is_none()).collect();
    let mut state = keyframes.clone();
    for (done, batch) in missing.chunks(BATCH).enumerate() {
        if progress.cancelled() {
            return Err(TrackerError::Cancelled);
        }
        let mut graph = FactorGraph::new(usize::MAX);
        let mut pairs = [Vec::new(), Vec::new()];
        for &k in batch {
            let (time, target) = (frames[k].time_s, state.len());
            let (before, after) = neighbours(&keyframes.time_s, time);
            let pose = interpolate_pose(&keyframes.time_s, &keyframes.geometry.poses, time, 0.0);
            state.push(&frames[k], pose, Some(before));
            pairs[0].push((before, target));
            pairs[1].push((after, target));
        }
        for pairs in &pairs {
            graph.add(pairs, &state.geometry, &state.frame, false);
        }
        let update = Update {
            options: DbaOptions {
                free: Free::Poses,
                ..settings.adjustment()
            },
            window: count..state.len(),
            inactive_from: None,
            batch: None,
        };
        for _ in 0..settings.filler_updates {
            update.run(&mut state, &mut graph, source)?;
        }
        graph.clear();
        source.change(&graph.take_changes())?;
        for (&k, pose) in batch.iter().zip(&state.geometry.poses[count..]) {
            poses[k] = Some(*pose);
        }
        state.truncate(count);
        let placed = ((done + 1) * BATCH).min(missing.len());
        progress.update(
            "placing frames between keyframes",
            placed,
            missing.len(),
            "",
        );
    }
    Ok(poses.into_iter().flatten().collect())
}

/// The guard of the published code, in its unit of time (frames).
pub const PUBLISHED_TIME_GUARD: f64 = 1e-3;

/// The keyframes around instant `time`: the last one not later (or the first), and the one after it
/// (or the same at the end). `times` ascends and is not empty.
#[must_use]
pub fn neighbours(times: &[f64], time: f64) -> (usize, usize) {
    let before = times.partition_point(|&t| t <= time).saturating_sub(1);
    (before, (before + 1).min(times.len() - 1))
}

/// Follows the screw motion from one keyframe to the next. Before the first and after the last
/// keyframe the pose is that keyframe's. `guard` is added to the time between keyframes: 0 passes
/// through both, the published code has [`PUBLISHED_TIME_GUARD`]. All poses map world to camera.
#[must_use]
pub fn interpolate_pose(times: &[f64], poses: &[Se3<f64>], time: f64, guard: f64) -> Se3<f64> {
    let (a, b) = neighbours(times, time);
    let between = times[b] - times[a] + guard;
    if a == b || between <= 0.0 || time < times[a] {
        return poses[a];
    }
    let velocity = poses[b].compose(&poses[a].inverse()).log() / between;
    Se3::exp(&(velocity * (time - times[a]))).compose(&poses[a])
}
