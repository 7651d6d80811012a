//! Settings of motion evidence and masks.

use super::check::above_zero;
use crate::dense::DenseError;
use serde::{Deserialize, Serialize};

/// Motion evidence and masks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotionConfig {
    /// Over how many frames flow is chained and compared, each both ways: the short for fast motion,
    /// the long for slow.
    pub spans: Vec<usize>,
    /// Noise of the flow, pixels at the working size.
    pub flow_noise_px: f32,
    /// Noise of the flow that grows with its length, as a share of it.
    pub flow_noise_share: f32,
    /// Residual at which a pixel is as likely to move as not, in units of the noise. The
    /// specification's 3 MAD are 2 standard deviations.
    pub threshold: f32,
    /// Strength of a vote for static against one for moving, 0..1: motion that one span alone can
    /// see outvotes the rest.
    pub static_vote: f32,
    /// Difference in brightness (0..255, mean of 5x5 pixels) between a pixel and its place in the
    /// other frame if it stood still that clearly speaks against standing still.
    pub brightness_step: f32,
    /// Least weight of flow that says a pixel moves although the pixel looks as if it stood still, 0..1.
    pub least_refuted: f32,
    /// How often evidence is averaged with that of the frames before and after, along the flow.
    pub votes: usize,
    /// Strength of the edge-aware smoothing of evidence, pixels squared (Min et al. 2014, lambda).
    pub smooth_lambda: f32,
    /// Evidence of a pixel on which all partners agree that it does not move, 0..1.
    pub agreement: f32,
    /// Weight of the belief that a pixel about which nothing is known does not move; the flow between
    /// two frames has 1.
    pub prior: f32,
    /// Weight of a track's verdict; the flow between two frames has 1.
    pub track_weight: f32,
    /// Components below this share of the image are dropped. Specification: 0.2 %.
    pub least_component: f32,
}

impl Default for MotionConfig {
    fn default() -> Self {
        Self {
            spans: vec![1, 4],
            flow_noise_px: 0.4,
            flow_noise_share: 0.05,
            threshold: 2.5,
            static_vote: 0.5,
            brightness_step: 6.0,
            least_refuted: 0.1,
            votes: 16,
            smooth_lambda: 100.0,
            agreement: 1.0,
            prior: 0.3,
            track_weight: 3.0,
            least_component: 0.002,
        }
    }
}

impl MotionConfig {
    /// Rejects settings that no computation could use: [`DenseError::Setting`].
    pub(super) fn check(&self) -> Result<(), DenseError> {
        above_zero(&[
            ("dense.motion.flow_noise_px", self.flow_noise_px.into()),
            ("dense.motion.brightness_step", self.brightness_step.into()),
            ("dense.motion.smooth_lambda", self.smooth_lambda.into()),
        ])
    }
}
