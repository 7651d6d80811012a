//! Errors of the reconstruction of cameras, depth and masks.

use crate::Category;
use m4_geometry::classical::dense::DenseError;
use m4_geometry::classical::sparse::SparseError;
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
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Sparse(SparseError::Setting { .. }) | Self::Dense(DenseError::Setting { .. }) => {
                Category::BadSettings
            }
            Self::Sparse(SparseError::Cancelled)
            | Self::Dense(DenseError::Cancelled { .. } | DenseError::Tracks(TrackError::Cancelled { .. })) => {
                Category::Stopped
            }
            Self::Megasam(e) if e.is_stop() => Category::Stopped,
            Self::Sparse(_) | Self::Dense(_) | Self::Megasam(_) => Category::BadInput,
        }
    }
}
