//! Settings of the dense half: a file for each stage, with what its settings may be.

mod bodies;
mod check;
mod consistent;
mod flow;
mod motion;
mod moving_depth;
mod plate;
mod static_depth;
mod tracks;

use super::DenseError;
use super::segment::SegmentConfig;
pub use bodies::BodyConfig;
pub(super) use check::{need, shares, whole};
pub use consistent::ConsistentConfig;
pub use flow::FlowConfig;
pub use motion::MotionConfig;
pub use moving_depth::MovingDepthConfig;
pub use plate::PlateConfig;
use serde::{Deserialize, Serialize};
pub use static_depth::StaticDepthConfig;
pub use tracks::{FillConfig, TrackConfig};

/// Settings of [`super::densify()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DenseConfig {
    /// Longest side of the images that flow, depth and masks are computed on, pixels; frames that are
    /// smaller are used as they are. The specification has "320-384"; 480 finds masks and thin parts that 320 misses and
    /// keeps 96 frames under a minute and a half on two cores.
    pub working_side_px: usize,
    /// Memory for the planes of all frames together, megabytes: long clips are worked on at a smaller size. 4096: 240 frames
    /// at 480x360.
    pub memory_mb: usize,
    /// Dense flow.
    pub flow: FlowConfig,
    /// Depth of what does not move.
    pub static_depth: StaticDepthConfig,
    /// What moves.
    pub motion: MotionConfig,
    /// Depth that agrees over time.
    pub consistent: ConsistentConfig,
    /// Masks against what is seen when nothing is in the way.
    pub plate: PlateConfig,
    /// Masks by a segmenter, where there is one.
    pub segment: SegmentConfig,
    /// Depth of what moves, from what it touches.
    pub moving_depth: MovingDepthConfig,
    /// Depth of what moves, as rigid bodies.
    pub bodies: BodyConfig,
    /// Points of what moves, followed through the clip.
    pub tracks: TrackConfig,
}

impl Default for DenseConfig {
    fn default() -> Self {
        Self {
            working_side_px: 480,
            memory_mb: 4096,
            flow: FlowConfig::default(),
            static_depth: StaticDepthConfig::default(),
            motion: MotionConfig::default(),
            consistent: ConsistentConfig::default(),
            plate: PlateConfig::default(),
            segment: SegmentConfig::default(),
            moving_depth: MovingDepthConfig::default(),
            bodies: BodyConfig::default(),
            tracks: TrackConfig::default(),
        }
    }
}

impl DenseConfig {
    /// Rejects settings that no computation could use: [`DenseError::Setting`].
    pub(super) fn check(&self) -> Result<(), DenseError> {
        whole(&[("dense.working_side_px", self.working_side_px, 64, 2048)])?;
        self.flow.check()?;
        self.static_depth.check()?;
        self.motion.check()?;
        self.consistent.check()?;
        self.plate.check()?;
        self.segment.check()?;
        self.moving_depth.check()?;
        self.bodies.check()?;
        self.tracks.check()
    }
}
