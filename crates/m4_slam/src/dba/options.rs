//! Settings of one adjustment.

use super::problem::Pinhole;
use super::robust::Robust;
use serde::{Deserialize, Serialize};

/// What moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Free {
    /// Poses alone.
    Poses,
    /// Poses and disparities.
    PosesAndDepth,
    /// Poses, disparities and the focal length.
    PosesDepthAndFocal,
}

impl Free {
    /// True where disparities move.
    #[must_use]
    pub fn depth(self) -> bool {
        self != Self::Poses
    }

    /// True where the focal length moves.
    #[must_use]
    pub fn focal(self) -> bool {
        self == Self::PosesDepthAndFocal
    }
}

/// Departures of the published program from what it means to do. None is on by default; they are there to
/// compare with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Quirks {
    /// The caller gets the disparities of the first iteration with the poses of the last: a clamp makes
    /// a new tensor after each, and only the first is the caller's.
    pub stale_disparity: bool,
    /// The step of the first pose of the window is left out when disparities are substituted back.
    pub first_pose_ignored: bool,
    /// The derivative by the focal length moves `fx` and `fy` by equal amounts, while the step keeps their
    /// ratio. Without effect on square pixels.
    pub equal_focal_rates: bool,
    /// Of the Python twin of the solver alone: where poses alone move, the damping is added to the diagonal of
    /// every 6x6 block, also of those between two poses.
    pub blockwise_damping: bool,
    /// When edges have to make room, the permutation that sorts their ages is taken for their ranks.
    pub permuted_ranks: bool,
    /// The times of keyframes stay behind when a keyframe is removed, so the filler interpolates
    /// between wrong times.
    pub stale_times: bool,
}

impl Quirks {
    /// Those of the published program (`megasam_compat` in the specification).
    #[must_use]
    pub fn megasam_compat() -> Self {
        Self {
            stale_disparity: true,
            first_pose_ignored: true,
            equal_focal_rates: true,
            blockwise_damping: false,
            permuted_ranks: true,
            stale_times: true,
        }
    }

    /// The change of `fy` with `fx` in the derivative.
    #[must_use]
    pub fn fy_rate(self, lens: &Pinhole<f64>) -> f64 {
        if self.equal_focal_rates { 1.0 } else { lens.fy / lens.fx }
    }
}

/// How a problem is adjusted. [`Default`] is the front end of section 1.5 of the specification.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DbaOptions {
    /// What moves.
    pub free: Free,
    /// Gauss-Newton iterations: 2; with the focal length 4.
    pub iterations: usize,
    /// Damping relative to the diagonal: 1e-4; 1e-5 in the back end.
    pub lm: f64,
    /// Absolute damping: 0.1; 0.01 in the back end.
    pub ep: f64,
    /// Weight of the depth prior, `None` without one: 0.05.
    pub prior_alpha: Option<f64>,
    /// Extra weight of every residual: none.
    pub robust: Robust,
    /// Least scaled depth of a point that counts: 0.25.
    pub min_depth: f64,
    /// Deliberate faults: none.
    pub quirks: Quirks,
}

impl Default for DbaOptions {
    fn default() -> Self {
        Self {
            free: Free::PosesAndDepth,
            iterations: 2,
            lm: 1e-4,
            ep: 0.1,
            prior_alpha: Some(0.05),
            robust: Robust::None,
            min_depth: super::projection::MIN_DEPTH,
            quirks: Quirks::default(),
        }
    }
}

impl DbaOptions {
    /// The back end: 2 iterations, or 4 where the focal length is free, with little damping.
    #[must_use]
    pub fn backend(free_focal: bool, prior_alpha: Option<f64>) -> Self {
        Self {
            free: if free_focal {
                Free::PosesDepthAndFocal
            } else {
                Free::PosesAndDepth
            },
            iterations: if free_focal { 4 } else { 2 },
            lm: 1e-5,
            ep: 1e-2,
            prior_alpha,
            ..Self::default()
        }
    }
}

/// Confidences count this much in the normal equations (the published scale).
pub const WEIGHT_SCALE: f64 = 1e-3;

/// Disparities above this are taken for failed: they become [`MIN_DISPARITY`].
pub const MAX_DISPARITY: f64 = 10.0;

/// Least disparity after a step.
pub const MIN_DISPARITY: f64 = 1e-6;

/// A disparity after its step.
#[must_use]
#[inline(always)]
pub fn stepped_disparity<T: m4_math::Real>(d: T, step: T) -> T {
    let d = d + step;
    let kept = if d > T::of(MAX_DISPARITY) { T::zero() } else { d };
    // written so that a NaN becomes the least disparity
    if kept > T::of(MIN_DISPARITY) {
        kept
    } else {
        T::of(MIN_DISPARITY)
    }
}

/// How an adjustment went.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DbaReport {
    /// Iterations done.
    pub iterations: usize,
    /// Iterations whose system was not positive definite: they moved nothing.
    pub failed: usize,
    /// Root mean square of the weighted residual before the last iteration, pixels of the grid; 0 without
    /// edges.
    pub rms_px: f64,
}
