//! Frames between keyframes: a pose by interpolation, refined against the neighbouring keyframes.

use super::correspondence::{Correspondence, TrackerError};
use super::keyframes::{FrameInput, Keyframes, Update};
use super::settings::TrackerSettings;
use crate::dba::{DbaOptions, Free};
use crate::megasam::graph::FactorGraph;
use m4_core::{Progress, Se3};

/// Frames that are placed at once: 16.
const BATCH: usize = 16;

/// The pose of every frame of `frames`, world to camera: that of the keyframe, or one placed between its neighbours.
/// Depth and poses of the keyframes stay as they are.
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
            let known = keyframes.frame.iter().position(|&k| k == f.frame);
            known.map(|k| keyframes.geometry.poses[k])
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
                robust: settings.frontend_robust,
                min_depth: settings.min_depth,
                #[cfg(test)]
                python_twin: settings.python_twin,
                ..DbaOptions::default()
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
        progress.update("placing frames between keyframes", placed, missing.len(), "");
    }
    Ok(poses.into_iter().flatten().collect())
}

/// The guard of the published code, in its unit of time (frames).
pub const PUBLISHED_TIME_GUARD: f64 = 1e-3;

/// The keyframes around instant `time`: the last one not later (or the first), and the one after it (or the same at
/// the end). `times` ascends and is not empty.
#[must_use]
pub fn neighbours(times: &[f64], time: f64) -> (usize, usize) {
    let before = times.partition_point(|&t| t <= time).saturating_sub(1);
    (before, (before + 1).min(times.len() - 1))
}

/// Follows the screw motion from one keyframe to the next. Before the first and after the last keyframe the pose is
/// that keyframe's. `guard` is added to the time between keyframes: 0 passes through both, the published code has
/// [`PUBLISHED_TIME_GUARD`]. All poses map world to camera.
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
