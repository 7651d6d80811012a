//! What refinement cannot work with.

use super::polarity::PolarityEvidence;
use super::source::VideoError;

/// Why there are no refined masks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InstanceError {
    /// The clip has no frames, or frames without pixels.
    #[error("the clip has {frames} frames of {}x{} pixels; at least one frame of {minimum} px per side is needed", size.0, size.1)]
    NoFrames {
        /// Frames.
        frames: usize,
        /// Width and height.
        size: (usize, usize),
        /// Least side, pixels.
        minimum: usize,
    },
    /// Coarse masks of another clip.
    #[error("{found} coarse masks were given for {expected} frames; give one per frame")]
    Count {
        /// Masks.
        found: usize,
        /// Frames.
        expected: usize,
    },
    /// A coarse mask without pixels.
    #[error("the coarse mask of frame {frame} has no pixels")]
    EmptyMask {
        /// Frame.
        frame: usize,
    },
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
            VideoError::Cancelled { .. } => Self::Cancelled {
                phase: "tracking objects",
            },
            other => Self::Video(other),
        }
    }
}
