//! What densification cannot work with.

use super::flow::FlowError;
use super::mono::MonoError;
use super::segment::SegmentError;
use crate::tracks::TrackError;

/// Rejects lists of another clip: `found` of `what` for `expected` frames.
pub(super) fn check_count(what: &str, found: usize, expected: usize) -> Result<(), DenseError> {
    if found == expected {
        return Ok(());
    }
    Err(DenseError::Input(format!("{what} of {found} frames were given for {expected} frames; give one per frame")))
}

/// Why no depth and masks could be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DenseError {
    /// Frames, cameras, masks or depth that do not fit together; the text says which.
    #[error("{0}")]
    Input(String),
    /// The source of flow failed.
    #[error("no flow between frames {frame} and {}", frame + 1)]
    Flow {
        /// The first of the two frames.
        frame: usize,
        /// What went wrong.
        source: FlowError,
    },
    /// The source of depth failed.
    #[error("no depth for frame {frame}")]
    Mono {
        /// The frame.
        frame: usize,
        /// What went wrong.
        source: MonoError,
    },
    /// The segmenter failed.
    #[error("no object masks in frame {frame}")]
    Segment {
        /// Which frame.
        frame: usize,
        /// What went wrong.
        source: SegmentError,
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
    /// Points could not be followed.
    #[error("dynamic objects could not be tracked")]
    Tracks(#[from] TrackError),
    /// The user asked to stop.
    #[error("stopped on request while {phase}")]
    Cancelled {
        /// What was going on.
        phase: &'static str,
    },
}
