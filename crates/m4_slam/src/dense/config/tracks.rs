//! Settings of points that are followed.

use super::check::{above_zero, need, shares, whole};
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
    /// Where their points are hidden.
    pub fill: FillConfig,
}

/// Points carried on where they are not seen, with the local rigid motion of their neighbours (section 3 of the front-end specification,
/// "cheaper substitute").
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FillConfig {
    /// Whether they are carried on; else a track ends where its chain ends.
    pub enabled: bool,
    /// Neighbours that a hidden point goes with.
    pub neighbours: usize,
    /// Neighbours farther away than this many times the distance of neighbouring tracks say nothing.
    pub reach: f32,
    /// Most frames that a point is carried on from the last in which it was seen.
    pub most_frames: usize,
    /// Most frames that it goes on as it moved last where no neighbour is seen; they count if it comes back.
    pub blind_frames: usize,
    /// A point has come back where what is seen lies at its depth, to within this share ...
    pub join_depth: f32,
    /// ... and where, some frames later, it is still within so many pixels of where its neighbours say.
    pub join_px: f32,
    /// A hidden point in front of what is seen by more than this share of the depth is wrong (section 2.6 of the specification of
    /// the optimiser: 5 %).
    pub free_space: f32,
}

impl Default for FillConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            neighbours: 16,
            reach: 24.0,
            most_frames: 60,
            blind_frames: 12,
            join_depth: 0.03,
            join_px: 3.0,
            free_space: 0.05,
        }
    }
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
            fill: FillConfig::default(),
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
            ("dense.tracks.fill.neighbours", self.fill.neighbours, 1, 64),
            ("dense.tracks.fill.most_frames", self.fill.most_frames, 1, 1_000_000),
            ("dense.tracks.fill.blind_frames", self.fill.blind_frames, 0, 1_000_000),
        ])?;
        above_zero(&[
            ("dense.tracks.round_trip_px", self.round_trip_px.into()),
            ("dense.tracks.jump", self.jump.into()),
            ("dense.tracks.fill.reach", self.fill.reach.into()),
            ("dense.tracks.fill.join_px", self.fill.join_px.into()),
        ])?;
        shares(&[
            ("dense.tracks.fill.join_depth", self.fill.join_depth.into()),
            ("dense.tracks.fill.free_space", self.fill.free_space.into()),
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
