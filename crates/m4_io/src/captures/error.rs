//! Errors of writing a capture for another tool.

use crate::ErrorKind;
use crate::image::{ReadImageError, WriteImageError};
use crate::scene::WriteFileError;
use std::path::PathBuf;

/// Why a capture could not be written for another tool.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteCaptureAsError {
    /// A file did not get to the disk as it was made.
    #[error(transparent)]
    File(#[from] WriteFileError),
    /// An image could not be written.
    #[error(transparent)]
    Picture(#[from] WriteImageError),
    /// An image that was written could not be read again.
    #[error("an image was written but does not read back: {0}; check the disk")]
    ReadBack(#[from] ReadImageError),
    /// The capture holds what the format cannot, or nothing.
    #[error("cannot write {}: {what}", path.display())]
    BadCapture {
        /// The file or folder.
        path: PathBuf,
        /// The fault, and where it is.
        what: String,
    },
    /// The recorder of another tool failed.
    #[error("cannot write {}: {what}", path.display())]
    Recorder {
        /// The file.
        path: PathBuf,
        /// Its message.
        what: String,
    },
    /// The caller asked to stop; nothing was left.
    #[error("stopped while writing {}", path.display())]
    Cancelled {
        /// The file or folder.
        path: PathBuf,
    },
}

impl WriteCaptureAsError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::BadCapture { .. } => ErrorKind::BadData,
            Self::Picture(e) => e.kind(),
            _ => ErrorKind::CannotWrite,
        }
    }
}
