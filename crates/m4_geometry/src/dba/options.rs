//! Settings of one adjustment, and what holds a disparity where the flow says little.

use super::problem::Pinhole;
use m4_core::Real;

/// Parameters that are adjusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

/// How a problem is adjusted. [`Default`] is the front end of docs/spec/front-end.md 1.5.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DbaOptions {
    /// Parameters that are adjusted.
    pub free: Free,
    /// Gauss-Newton iterations: 2; with the focal length 4.
    pub iterations: usize,
    /// Damping relative to the diagonal: 1e-4; 1e-5 in the back end.
    pub lm: f64,
    /// Absolute damping: 0.1; 0.01 in the back end.
    pub ep: f64,
    /// Weight of the depth prior, `None` without one: 0.05.
    pub prior_alpha: Option<f64>,
    /// Scale of Cauchy's weight `1 / (1 + s^2)`, `s` being the length of the residual over it,
    /// pixels of the grid (iteratively reweighted least squares); `None` where every residual
    /// counts in full, as in the published solver, whose confidences come from a network.
    pub cauchy_px: Option<f64>,
    /// Least scaled depth of a point that counts: 0.25.
    pub min_depth: f64,
    /// As the Python twin of the published solver, which the fixtures come from: the derivative by
    /// the focal length moves `fx` and `fy` by equal amounts, and where poses alone move the
    /// damping is added to the diagonal of every 6x6 block, also of those between two poses.
    #[cfg(test)]
    pub(crate) python_twin: bool,
}

impl Default for DbaOptions {
    fn default() -> Self {
        Self {
            free: Free::PosesAndDepth,
            iterations: 2,
            lm: 1e-4,
            ep: 0.1,
            prior_alpha: Some(0.05),
            cauchy_px: None,
            min_depth: super::problem::MIN_DEPTH,
            #[cfg(test)]
            python_twin: false,
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

    /// One over the squared scale of the extra weight; 0 makes the weight 1 exactly.
    pub(super) fn inverse_square(&self) -> f64 {
        self.cauchy_px
            .map_or(0.0, |scale_px| 1.0 / (scale_px * scale_px))
    }

    /// The change of `fy` with `fx` in the derivative by the focal length: their ratio, as the step
    /// keeps it.
    pub(super) fn fy_rate(&self, lens: &Pinhole<f64>) -> f64 {
        #[cfg(test)]
        if self.python_twin {
            return 1.0;
        }
        lens.fy / lens.fx
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
pub fn stepped_disparity<T: Real>(d: T, step: T) -> T {
    let d = d + step;
    let limited = if d > T::of(MAX_DISPARITY) {
        T::zero()
    } else {
        d
    };
    // written so that a NaN becomes the least disparity
    if limited > T::of(MIN_DISPARITY) {
        limited
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
    /// Root mean square of the weighted residual before the last iteration, pixels of the grid; 0
    /// without edges.
    pub rms_px: f64,
}

/// Below this a sensor disparity counts as unknown.
pub const SENSOR_KNOWN: f64 = 1e-8;

/// Added to the curvature of every disparity, so that it can be inverted.
pub const CURVATURE_FLOOR: f64 = 1e-7;

/// `(added curvature, added gradient)` of one disparity (docs/spec/front-end.md 1.6):
/// with `m = 1` where the sensor knows the depth, `C += m alpha + (1 - m) eta + 1e-7` and
/// `b -= m alpha (d - d_sensor)`. `alpha = None` switches the prior off and leaves damping alone.
#[must_use]
#[inline(always)]
pub fn depth_prior<T: Real>(alpha: Option<T>, eta: T, disparity: T, sensor: T) -> (T, T) {
    let floor = T::of(CURVATURE_FLOOR);
    match alpha {
        Some(alpha) if sensor > T::of(SENSOR_KNOWN) => {
            (alpha + floor, -alpha * (disparity - sensor))
        }
        _ => (eta + floor, T::zero()),
    }
}
