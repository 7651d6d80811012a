//! The methods, settings and errors of the dense half. All other values are constants of the files
//! that use them.

use super::mono::MonoDepth;
use super::segment::Segmenter;
use crate::flow::ScaledFrame;
use crate::tracks::TrackError;
use m4_core::Flow;
use serde::{Deserialize, Serialize};

/// Why a network or another method failed.
pub type SourceError = Box<dyn std::error::Error + Send + Sync>;

/// Measures flow between frame `i` and the next: from the first to the second, and back, of the
/// size of the images.
///
/// Called from several threads at once; the same images must give the same bits.
pub type MeasureFlow<'a> =
    dyn Fn(usize, &ScaledFrame, &ScaledFrame) -> Result<(Flow, Flow), SourceError> + Sync + 'a;

/// The methods for flow, segmentation and monocular depth.
#[derive(Clone, Copy)]
pub struct Sources<'a> {
    /// Measures flow between neighbouring frames.
    pub flow: &'a MeasureFlow<'a>,
    /// Segments dynamic regions, if present; masks of the user stay as they are.
    pub segmenter: Option<&'a Segmenter<'a>>,
    /// Depth from one image, if there is any.
    pub mono: Option<MonoDepth<'a>>,
}

/// Settings of [`super::estimate()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DenseConfig {
    /// Longest side of the images that flow, depth and masks are computed on, pixels; frames that
    /// are smaller are used as they are. The specification has "320-384"; 480 finds masks and thin
    /// parts that 320 misses and keeps 96 frames under a minute and a half on two cores.
    pub working_side_px: usize,
    /// Memory for the planes of all frames together, megabytes: long clips are processed at a
    /// smaller size. 4096: 270 frames at 480x360.
    pub memory_mb: usize,
    /// Whether points of the dynamic region are tracked through the clip.
    pub tracks: bool,
}

impl Default for DenseConfig {
    fn default() -> Self {
        Self {
            working_side_px: 480,
            memory_mb: 4096,
            tracks: true,
        }
    }
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
        source: SourceError,
    },
    /// The segmenter failed.
    #[error("no object masks in frame {frame}")]
    Segment {
        /// Which frame.
        frame: usize,
        /// What went wrong.
        source: SourceError,
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
