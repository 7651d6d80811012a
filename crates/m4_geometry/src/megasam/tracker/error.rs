//! Why tracking ended early.

use super::correspondence::CorrespondenceError;
use crate::dba::DbaError;

/// Why a clip could not be tracked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrackerError {
    /// The source of correspondences gave up.
    #[error(transparent)]
    Correspondence(#[from] CorrespondenceError),
    /// Planes or indices that do not fit.
    #[error(transparent)]
    Dba(#[from] DbaError),
    /// A clip has at least two frames.
    #[error("the clip has {found} frame(s); at least 2 are needed to observe motion")]
    TooFewFrames {
        /// Frames given.
        found: usize,
    },
    /// Frames out of order.
    #[error("frame {frame} is at {time_s} s, not after the frame before it; give frames in order of time")]
    Order {
        /// The frame at fault.
        frame: usize,
        /// Its time.
        time_s: f64,
    },
    /// A plane of the wrong size.
    #[error("the sensor disparity of frame {frame} has {found} values while the grid has {expected} pixels")]
    PlaneSize {
        /// The frame at fault.
        frame: usize,
        /// Its length.
        found: usize,
        /// Pixels of the grid.
        expected: usize,
    },
    /// The state became useless.
    #[error(
        "the adjustment of {keyframes} keyframes gave a NaN or infinite value; check the correspondences (or supply \
         a capture with poses)"
    )]
    Diverged {
        /// Keyframes at that time.
        keyframes: usize,
    },
    /// The user stopped the run.
    #[error("stopped by the user")]
    Cancelled,
}
