//! What can go wrong.

use super::PairFlowError;
use crate::megasam::cvd::{CvdError, PairError};
use crate::megasam::tracker::TrackerError;
use crate::megasam::tracker::mono::MonoError;

/// Why there is no geometry.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MegasamError {
    /// Images that cannot be tracked.
    #[error(
        "images of {}x{} pixels cannot be tracked at {pixels} pixels; fewer than 8 per side would be left, or the size is invalid",
        full.0, full.1
    )]
    Size {
        /// Width and height.
        full: (usize, usize),
        /// Pixels that were asked for.
        pixels: f64,
    },
    /// Lists that do not belong together.
    #[error("{what} of {found} frames were given for {expected} images; give one an image, all of one size")]
    Count {
        /// What is listed.
        what: &'static str,
        /// Entries given.
        found: usize,
        /// Images.
        expected: usize,
    },
    /// An image of another size.
    #[error("image {frame} has {}x{} pixels where the first has {}x{}", found.0, found.1, expected.0, expected.1)]
    OtherSize {
        /// Its number.
        frame: usize,
        /// Its width and height.
        found: (usize, usize),
        /// Those of the first.
        expected: (usize, usize),
    },
    /// Depth from one image that is empty.
    #[error("the depth of image {frame} has no pixels; give a map of the shape of the image")]
    NoPixels {
        /// Its number.
        frame: usize,
    },
    /// Depth without scale.
    #[error(transparent)]
    Mono(#[from] MonoError),
    /// Cameras could not be found.
    #[error(transparent)]
    Tracker(#[from] TrackerError),
    /// Flow could not be had.
    #[error(transparent)]
    Flow(#[from] PairFlowError),
    /// Flow could not be kept.
    #[error(transparent)]
    Pairs(#[from] PairError),
    /// Depth could not be made consistent.
    #[error(transparent)]
    Depth(#[from] CvdError),
    /// The user stopped.
    #[error("stopped by the user")]
    Cancelled,
}

impl MegasamError {
    /// True where the user stopped.
    #[must_use]
    pub fn is_stop(&self) -> bool {
        matches!(
            self,
            Self::Cancelled | Self::Tracker(TrackerError::Cancelled) | Self::Depth(CvdError::Cancelled { .. })
        )
    }
}
