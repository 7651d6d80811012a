//! A pose between two keyframes.

use m4_core::Se3;

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
