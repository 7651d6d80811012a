//! What can go wrong.

use super::clip::ClipError;

/// Why points were not followed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Tapip3dError {
    /// The clip has no frames.
    #[error("points cannot be tracked in a clip without frames")]
    NoFrames,
    /// A frame could not be had.
    #[error("frame {frame} of the clip: {source}")]
    Frame {
        /// The frame.
        frame: usize,
        /// What the clip says.
        source: ClipError,
    },
    /// A frame has no pixels, or its camera is none.
    #[error("frame {frame} cannot be used to track points: {reason}")]
    BadFrame {
        /// The frame.
        frame: usize,
        /// The fault.
        reason: &'static str,
    },
    /// The network cannot work at this size.
    #[error(
        "points cannot be tracked at {width} x {height} px: the coarsest map has to hold {neighbours} points, which takes 32 by 32 px \
         for each; choose a larger size"
    )]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Neighbours that the network looks at.
        neighbours: usize,
    },
    /// A point to follow is in no frame of the clip, or nowhere.
    #[error("point {index} cannot be tracked: {reason}")]
    Query {
        /// Its number.
        index: usize,
        /// The fault.
        reason: String,
    },
    /// There is no depth where it is needed.
    #[error("no depth is known in frames {first} to {last}: points cannot be tracked there")]
    NoDepth {
        /// The first of the frames.
        first: usize,
        /// The last of them.
        last: usize,
    },
    /// The network's answer is no number.
    #[error(
        "the network lost its points in frames {first} to {last}: its output is NaN or infinite; 32-bit precision may help"
    )]
    NotFinite {
        /// The first frame of the window.
        first: usize,
        /// The last one.
        last: usize,
    },
    /// The user stopped it.
    #[error("tracking points was stopped")]
    Stopped,
    /// The device failed, for one for lack of memory.
    #[error("the device that tracks points failed: {0}")]
    Device(String),
}
