//! Errors of mask refinement and point tracking.

use crate::error::Category;
use m4_geometry::masks::InstanceError;
use m4_geometry::tracks::TrackError;

/// Why masks could not be refined or points not be followed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EnhanceError {
    /// No method was selected, or none is available.
    #[error("there is nothing to do: --segmenter none and --tracker none leave a capture unchanged; omit one of them")]
    NothingToDo,
    /// A frame without any word on the dynamic part.
    #[error(
        "frame {frame} ({name:?}) has neither a motion map nor a mask, so there is nothing to refine; create the capture with masks \
         (`minute4d geometry`), or import it with them"
    )]
    NoCoarse {
        /// Its index.
        frame: usize,
        /// Its name.
        name: String,
    },
    /// Refinement failed.
    #[error(transparent)]
    Instances(#[from] InstanceError),
    /// Points could not be followed.
    #[error(transparent)]
    Tracks(#[from] TrackError),
}

impl EnhanceError {
    /// Returns the category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::NothingToDo => Category::Usage,
            Self::Instances(InstanceError::Cancelled { .. }) | Self::Tracks(TrackError::Cancelled { .. }) => {
                Category::Stopped
            }
            Self::Instances(InstanceError::Setting { .. }) | Self::Tracks(TrackError::Setting { .. }) => {
                Category::BadSettings
            }
            Self::NoCoarse { .. } | Self::Instances(_) | Self::Tracks(_) => Category::BadInput,
        }
    }
}
