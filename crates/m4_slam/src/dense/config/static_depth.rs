//! Settings of depth of what stands still.

use super::check::{above_zero, need};
use crate::dense::DenseError;
use serde::{Deserialize, Serialize};

/// Plane sweep, aggregation, consistency and fill.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StaticDepthConfig {
    /// Disparities tried between the farthest and the nearest surface.
    pub hypotheses: usize,
    /// Parallax of a point at median depth between a frame and its partners on each side, pixels at
    /// the working size: one partner a target and side.
    pub parallax_px: Vec<f64>,
    /// How far away in time partners may be, frames. Specification: 8; slow cameras need more.
    pub partner_frames: usize,
    /// Least parallax of a partner, pixels at the working size.
    pub least_parallax_px: f64,
    /// Penalty of a disparity step of one between neighbours, census bits (Hirschmueller 2008, P1).
    pub small_step: i16,
    /// Penalty of a larger step on a flat image, census bits (P2).
    pub large_step: i16,
    /// Largest difference to a partner's disparity that counts as agreement, in hypothesis steps.
    pub agree_steps: f32,
    /// Patches of agreement smaller than this are taken for chance, pixels at the working size.
    pub least_patch_px: usize,
    /// Weight of one sparse point in the fill; a pixel on which all partners agree has 1.
    pub point_weight: f32,
    /// Strength of the edge-aware fill, pixels squared (Min et al. 2014, lambda).
    pub fill_lambda: f32,
    /// Strength of the last smoothing, pixels squared.
    pub denoise_lambda: f32,
    /// Colour difference that stops the fill, 0..255 (Min et al. 2014, sigma).
    pub fill_sigma: f32,
}

impl Default for StaticDepthConfig {
    fn default() -> Self {
        Self {
            hypotheses: 64,
            parallax_px: vec![6.0, 12.0],
            partner_frames: 24,
            least_parallax_px: 1.5,
            small_step: 6,
            large_step: 40,
            agree_steps: 1.5,
            least_patch_px: 30,
            point_weight: 4.0,
            fill_lambda: 900.0,
            denoise_lambda: 4.0,
            fill_sigma: 8.0,
        }
    }
}

impl StaticDepthConfig {
    /// Rejects settings that no computation could use: [`DenseError::Setting`].
    pub(super) fn check(&self) -> Result<(), DenseError> {
        let n = self.hypotheses;
        need(
            (8..=256).contains(&n),
            "dense.static_depth.hypotheses",
            n as f64,
            "8 to 256",
        )?;
        let parallax = self.parallax_px.iter().copied().fold(f64::INFINITY, f64::min);
        let good = parallax > 0.0 && parallax.is_finite();
        need(good, "dense.static_depth.parallax_px", parallax, "a list above 0")?;
        for (name, value) in [
            ("dense.static_depth.small_step", self.small_step),
            ("dense.static_depth.large_step", self.large_step),
        ] {
            need((0..=1000).contains(&value), name, value.into(), "0 to 1000")?;
        }
        above_zero(&[
            ("dense.static_depth.fill_lambda", self.fill_lambda.into()),
            ("dense.static_depth.denoise_lambda", self.denoise_lambda.into()),
            ("dense.static_depth.fill_sigma", self.fill_sigma.into()),
            ("dense.static_depth.agree_steps", self.agree_steps.into()),
        ])
    }
}
