//! Settings of refinement, and what it cannot work with. All other values are constants of the files that use them.

use super::coarse::TAU_STILL;
use super::polarity::PolarityEvidence;
use super::source::VideoError;
use serde::{Deserialize, Serialize};

/// Settings of [`super::refine()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineSettings {
    /// Longest side of the masks while things are followed, pixels; frames that are smaller are used as they are. 960: the clips of the
    /// paper's data sets are not made smaller.
    pub side_px: usize,
    /// Motion above which a pixel counts as dynamic. Paper: tau = 0.7.
    pub tau: f32,
    /// Frames from one search for new things to the next. Paper: B = 50 for DyCheck, 2 for NVIDIA Dynamic, 10 for DAVIS.
    pub every_frames: usize,
}

impl Default for RefineSettings {
    fn default() -> Self {
        Self { side_px: 960, tau: 0.7, every_frames: 10 }
    }
}

impl RefineSettings {
    /// Rejects settings that no refinement could use.
    ///
    /// # Errors
    ///
    /// [`InstanceError::Setting`].
    pub fn check(&self) -> Result<(), InstanceError> {
        let need = |ok: bool, name, value: f64, range| {
            if ok { Ok(()) } else { Err(InstanceError::Setting { name, value, range }) }
        };
        let side = self.side_px;
        need((64..=4096).contains(&side), "side_px", side as f64, "64 to 4096")?;
        let every = self.every_frames;
        need((1..=1_000_000).contains(&every), "every_frames", every as f64, "1 to 1000000")?;
        need((TAU_STILL..=1.0).contains(&self.tau), "tau", self.tau.into(), "0.3 to 1")
    }
}

/// Why there are no refined masks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InstanceError {
    /// A clip without pixels, or coarse masks of another clip; the text says which.
    #[error("{0}")]
    Input(String),
    /// A map of motion is inverted.
    #[error(
        "the motion maps look inverted ({evidence}): high values must mean dynamic; replace each value by 255 minus it, or \
         pass `--segmenter none` to keep the masks as they are"
    )]
    Polarity {
        /// What was found.
        evidence: PolarityEvidence,
    },
    /// A setting out of range.
    #[error("setting {name} is {value}; it must be {range}")]
    Setting {
        /// Path of the setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        range: &'static str,
    },
    /// Following failed.
    #[error(transparent)]
    Video(VideoError),
    /// The user asked to stop.
    #[error("stopped on request while {phase}")]
    Cancelled {
        /// What was going on.
        phase: &'static str,
    },
}

impl From<VideoError> for InstanceError {
    fn from(error: VideoError) -> Self {
        match error {
            VideoError::Cancelled { .. } => Self::Cancelled { phase: "tracking objects" },
            other => Self::Video(other),
        }
    }
}
