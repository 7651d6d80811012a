//! Settings of points that are followed.

use super::check::{above_zero, need, whole};
use crate::dense::DenseError;
use serde::{Deserialize, Serialize};

/// Points of moving parts, followed along the flow.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackConfig {
    /// Whether points are followed at all.
    pub enabled: bool,
    /// Distance of the points where they start, pixels at the working size.
    pub spacing_px: usize,
    /// Points start in every n-th frame, where no track passes. The specification's queries: every frame to every 10th.
    pub every: usize,
    /// Flow whose round trip misses by more than this is not followed, pixels at the working size.
    pub round_trip_px: f32,
    /// Fewest frames of a track.
    pub shortest: usize,
    /// A track is cut at a step longer than this many times its median step.
    pub jump: f32,
    /// Time over which the depth of a track is smoothed, standard deviation in frames; 0 for none.
    pub smooth_frames: f32,
    /// Most tracks; more are thinned everywhere alike.
    pub most: usize,
}

impl Default for TrackConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            spacing_px: 4,
            every: 4,
            round_trip_px: 1.0,
            shortest: 4,
            jump: 5.0,
            smooth_frames: 2.0,
            most: 20_000,
        }
    }
}

impl TrackConfig {
    /// Rejects settings that no computation could use: [`DenseError::Setting`].
    pub(super) fn check(&self) -> Result<(), DenseError> {
        whole(&[
            ("dense.tracks.spacing_px", self.spacing_px, 1, 256),
            ("dense.tracks.every", self.every, 1, 10_000),
            ("dense.tracks.shortest", self.shortest, 2, 10_000),
            ("dense.tracks.most", self.most, 1, 1_000_000),
        ])?;
        above_zero(&[
            ("dense.tracks.round_trip_px", self.round_trip_px.into()),
            ("dense.tracks.jump", self.jump.into()),
        ])?;
        let smooth = self.smooth_frames;
        need(
            (0.0..=100.0).contains(&smooth),
            "dense.tracks.smooth_frames",
            smooth.into(),
            "0 to 100",
        )
    }
}
