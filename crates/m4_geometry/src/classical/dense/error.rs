//! What densification cannot work with.

use super::flow::FlowError;
use super::mono::MonoError;
use super::segment::SegmentError;
use crate::tracks::TrackError;

/// Why no depth and masks could be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DenseError {
    /// No frames were given.
    #[error("there are no frames; give at least one")]
    NoFrames,
    /// Frames and cameras do not belong together.
    #[error("{frames} frames but {cameras} cameras; the reconstruction must be of the same frames")]
    Count {
        /// Frames given.
        frames: usize,
        /// Cameras of the reconstruction.
        cameras: usize,
    },
    /// Frames of different sizes, or too small to work on.
    #[error(
        "frame {frame} is {}x{} where {}x{} was expected; all frames must have one size, at least {minimum} px per side",
        found.0, found.1, expected.0, expected.1
    )]
    Size {
        /// Which frame.
        frame: usize,
        /// Its width and height.
        found: (usize, usize),
        /// The size of the first frame.
        expected: (usize, usize),
        /// Least side, pixels.
        minimum: usize,
    },
    /// A camera that cannot take images.
    #[error("the camera of frame {frame} has {what}; the reconstruction is damaged, make it again")]
    Camera {
        /// Which frame.
        frame: usize,
        /// What is wrong with it.
        what: &'static str,
    },
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
    /// Masks or depth were given for another clip.
    #[error("{what} of {found} frames were given for {expected} frames; give one per frame")]
    Given {
        /// Masks or depth.
        what: &'static str,
        /// How many were given.
        found: usize,
        /// Frames of the clip.
        expected: usize,
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
