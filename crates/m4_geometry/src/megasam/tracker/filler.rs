//! Frames between keyframes: a pose by interpolation, refined against the neighbouring keyframes.

use super::correspondence::Correspondence;
use super::error::TrackerError;
use super::interpolation::{interpolate_pose, neighbours};
use super::keyframes::{FrameInput, Keyframes};
use super::settings::TrackerSettings;
use super::update::Update;
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
