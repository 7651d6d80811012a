//! Errors of reading and writing videos, images, captures, scenes and cameras.

use super::Category;
use m4_io::capture::WriteCaptureError;
use m4_io::dataset::ReadSourceError;
use m4_io::image::{ReadImageError, WriteImageError};
use m4_io::scene::safetensors::{ReadSceneError, WriteSceneError};
use m4_io::trajectory::ReadTrajectoryError;
use m4_io::video::{ReadVideoError, WriteVideoError};

/// Why data could not be read or written: the errors of [`m4_io`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DataError {
    /// Reading a clip.
    #[error(transparent)]
    ReadVideo(#[from] ReadVideoError),
    /// Writing a clip.
    #[error(transparent)]
    WriteVideo(#[from] WriteVideoError),
    /// Reading an image.
    #[error(transparent)]
    ReadImage(#[from] ReadImageError),
    /// Writing an image.
    #[error(transparent)]
    WriteImage(#[from] WriteImageError),
    /// Reading a capture.
    #[error(transparent)]
    ReadCapture(#[from] ReadSourceError),
    /// Writing a capture.
    #[error(transparent)]
    WriteCapture(#[from] WriteCaptureError),
    /// Reading a scene.
    #[error(transparent)]
    ReadScene(#[from] ReadSceneError),
    /// Writing a scene.
    #[error(transparent)]
    WriteScene(#[from] WriteSceneError),
    /// Reading cameras.
    #[error(transparent)]
    ReadTrajectory(#[from] ReadTrajectoryError),
}

impl DataError {
    /// Returns the category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::ReadVideo(ReadVideoError::BadOption { .. }) => Category::BadSettings,
            Self::ReadVideo(e) => e.kind().into(),
            Self::WriteVideo(e) => e.kind().into(),
            Self::ReadImage(e) => e.kind().into(),
            Self::WriteImage(e) => e.kind().into(),
            Self::ReadCapture(e) => e.kind().into(),
            Self::WriteCapture(e) => e.kind().into(),
            Self::ReadScene(e) => e.kind().into(),
            Self::WriteScene(e) => e.kind().into(),
            Self::ReadTrajectory(e) => e.kind().into(),
        }
    }
}
