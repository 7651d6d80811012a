//! Why masks could not be refined.

use crate::error::Category;
use m4_slam::instances::InstanceError;

/// Why masks could not be refined.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EnhanceError {
    /// A frame without any word on what moves.
    #[error(
        "frame {frame} ({name:?}) has neither a map of motion nor a mask, so there is nothing to refine; make the capture with masks \
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
}

impl EnhanceError {
    pub(crate) fn category(&self) -> Category {
        match self {
            Self::Instances(InstanceError::Cancelled { .. }) => Category::Stopped,
            Self::Instances(InstanceError::Setting { .. }) => Category::BadSettings,
            Self::NoCoarse { .. } | Self::Instances(_) => Category::BadInput,
        }
    }
}
