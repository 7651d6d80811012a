//! Thresholds that follow the clip.

use super::motion::RAYLEIGH_MEDIAN;
use super::rotation::{KEYFRAME_PARALLAX, Sway};

/// Bundle adjustment of all frames has a loss as wide as this many robust standard deviations of the residuals. 2.385: 95 % efficiency
/// on normal errors (Holland and Welsch 1977).
const CAUCHY_DEVIATIONS: f64 = 2.385;

/// Thresholds that follow how much parallax there is and how large the residuals are.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Scale of the Cauchy loss of bundle adjustment, working pixels. 1 while the map grows.
    pub cauchy_px: f64,
    /// Points whose rays meet at less than this are not triangulated, degrees. 1.5: docs/spec/front-end.md 7.1. In
    /// clips with so little parallax that this would leave few points, half the angle that the
    /// greatest median parallax stands for.
    pub min_angle_deg: f64,
    /// See [`KEYFRAME_PARALLAX`].
    pub keyframe_parallax: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            cauchy_px: 1.0,
            min_angle_deg: 1.5,
            keyframe_parallax: KEYFRAME_PARALLAX,
        }
    }
}

impl Limits {
    /// Narrows the loss to residuals with this median, pixels: what a wide loss lets pass (slow
    /// motion, patches on two surfaces) would pull at the focal length. Never under 0.05 pixels.
    pub fn sharpen(&mut self, median_px: f64) {
        let scale = CAUCHY_DEVIATIONS * median_px / RAYLEIGH_MEDIAN;
        self.cauchy_px = self.cauchy_px.min(scale.max(0.05));
    }

    /// Little parallax asks for keyframes and rays that lie closer together; `width` is that of the working size.
    pub fn adapt(&mut self, sway: &Sway, width: usize) {
        let angle_deg = (sway.parallax_px / sway.focal).to_degrees();
        self.min_angle_deg = self.min_angle_deg.min(0.5 * angle_deg);
        self.keyframe_parallax = self.keyframe_parallax.min(0.2 * sway.parallax_px / width as f64);
    }
}
