//! Errors of single stages: geometry, enhancement.

use super::Category;
use m4_geometry::classical::dense::DenseError;
use m4_geometry::classical::sparse::SparseError;
use m4_geometry::masks::InstanceError;
use m4_geometry::megasam::MegasamError;
use m4_geometry::tracks::TrackError;

/// Why nothing could be reconstructed from a video.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReconstructionError {
    /// Cameras and tracks from a video.
    #[error(transparent)]
    Sparse(#[from] SparseError),
    /// Depth and masks from a video.
    #[error(transparent)]
    Dense(#[from] DenseError),
    /// MegaSaM's reconstruction failed.
    #[error(transparent)]
    Megasam(#[from] MegasamError),
}

impl ReconstructionError {
    /// Returns the category of the failure.
    pub fn category(&self) -> Category {
        match self {
            Self::Sparse(SparseError::Setting { .. }) | Self::Dense(DenseError::Setting { .. }) => {
                Category::BadSettings
            }
            Self::Sparse(SparseError::Cancelled)
            | Self::Dense(
                DenseError::Cancelled { .. } | DenseError::Tracks(TrackError::Cancelled { .. }),
            ) => Category::Stopped,
            Self::Megasam(e) if e.is_stop() => Category::Stopped,
            Self::Sparse(_) | Self::Dense(_) | Self::Megasam(_) => Category::BadInput,
        }
    }
}

/// Why masks could not be refined or points not be followed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EnhanceError {
    /// Refinement failed.
    #[error(transparent)]
    Instances(#[from] InstanceError),
    /// Points could not be followed.
    #[error(transparent)]
    Tracks(#[from] TrackError),
}

impl EnhanceError {
    /// Returns the category of the failure.
    pub fn category(&self) -> Category {
        match self {
            Self::Instances(InstanceError::Cancelled { .. })
            | Self::Tracks(TrackError::Cancelled { .. }) => Category::Stopped,
            Self::Instances(InstanceError::Setting { .. })
            | Self::Tracks(TrackError::Setting { .. }) => Category::BadSettings,
            Self::Instances(_) | Self::Tracks(_) => Category::BadInput,
        }
    }
}
