//! Settings of moving parts as rigid bodies.

use super::check::{above_zero, shares, whole};
use crate::dense::DenseError;
use serde::{Deserialize, Serialize};

/// Moving parts as rigid bodies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BodyConfig {
    /// Distance of the pixels that are adjusted, pixels at the working size.
    pub block_px: usize,
    /// Over how many frames a part is compared with itself, each both ways.
    pub spans: Vec<usize>,
    /// Parts smaller than this share of the image are left alone.
    pub least_share: f32,
    /// Fewest frames.
    pub shortest: usize,
    /// Most frames that are adjusted together: bounds memory.
    pub longest: usize,
    /// Fewest adjusted pixels a frame.
    pub least_points: usize,
    /// A part that grows or shrinks by more than this factor from one frame to the next is another part.
    pub growth: f32,
    /// Flow whose round trip misses by more than this is not followed, pixels at the working size.
    pub round_trip_px: f32,
    /// Noise of the flow, pixels at the working size (scale of the Cauchy weight).
    pub noise_px: f32,
    /// Weight of the disparity that contact suggests.
    pub prior: f32,
    /// Share of a part's relief that is kept, 0..1; the rest is drawn to a plane.
    pub relief: f32,
    /// Iterations with the shape held.
    pub pose_iterations: usize,
    /// Iterations of everything.
    pub iterations: usize,
    /// Share of the frames whose lower bound of the scale the scale exceeds.
    pub touch_quantile: f32,
    /// A part stands on ground where what lies under it comes nearer by more than this share of its disparity a row.
    pub ground_slope: f32,
    /// Least share of its frames in which a part must stand for its scale to be known.
    pub standing_share: f32,
    /// A part whose way, at its best scale, is shorter than this share of what the camera's way would make of it at
    /// another, stays in place, and that is its scale.
    pub still_rest: f64,
    /// ... unless that is farther than what it hides by more than this factor.
    pub still_range: f32,
    /// Parts that fly take their distance from how they fall, where there is a ground.
    pub falling: bool,
    /// Strength of the edge-aware spreading, pixels squared (Min et al. 2014, lambda).
    pub fill_lambda: f32,
}

impl Default for BodyConfig {
    fn default() -> Self {
        Self {
            block_px: 4,
            spans: vec![1, 3, 8],
            least_share: 0.002,
            shortest: 5,
            longest: 96,
            least_points: 12,
            growth: 1.6,
            round_trip_px: 1.5,
            noise_px: 0.6,
            prior: 0.001,
            relief: 0.5,
            pose_iterations: 6,
            iterations: 20,
            touch_quantile: 0.75,
            ground_slope: 0.003,
            standing_share: 0.3,
            still_rest: 0.12,
            still_range: 1.2,
            falling: true,
            fill_lambda: 100.0,
        }
    }
}

impl BodyConfig {
    /// Rejects settings that no computation could use: [`DenseError::Setting`].
    pub(super) fn check(&self) -> Result<(), DenseError> {
        whole(&[
            ("dense.bodies.block_px", self.block_px, 1, 64),
            ("dense.bodies.shortest", self.shortest, 2, 10_000),
            ("dense.bodies.longest", self.longest, self.shortest, 10_000),
        ])?;
        above_zero(&[
            ("dense.bodies.growth", self.growth.into()),
            ("dense.bodies.round_trip_px", self.round_trip_px.into()),
            ("dense.bodies.noise_px", self.noise_px.into()),
            ("dense.bodies.prior", self.prior.into()),
            ("dense.bodies.still_range", self.still_range.into()),
            ("dense.bodies.fill_lambda", self.fill_lambda.into()),
        ])?;
        shares(&[
            ("dense.bodies.touch_quantile", self.touch_quantile.into()),
            ("dense.bodies.relief", self.relief.into()),
            ("dense.bodies.least_share", self.least_share.into()),
        ])
    }
}
