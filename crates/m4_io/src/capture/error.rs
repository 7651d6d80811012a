//! Errors of writing captures.

use crate::ErrorKind;
use crate::image::WriteImageError;
use std::io;
use std::path::PathBuf;

/// Why a capture could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteCaptureError {
    /// The file system refused.
    #[error("cannot write {}: {source}; check the folder's permissions and free space", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// An image could not be written.
    #[error(transparent)]
    Image(#[from] WriteImageError),
    /// A frame holds a number that no file can.
    #[error("frame {frame} ({name:?}) of the capture cannot be written to {}: {what}", path.display())]
    BadFrame {
        /// The JSON file.
        path: PathBuf,
        /// Index in the capture.
        frame: usize,
        /// Its name.
        name: String,
        /// The fault.
        what: String,
    },
    /// The tracks are not of these frames.
    #[error("the capture for {} has {frames} frames but tracks over {tracks}; compute tracks of these frames, or remove them", path.display())]
    Tracks {
        /// The JSON file.
        path: PathBuf,
        /// Frames of the capture.
        frames: usize,
        /// Frames of the tracks.
        tracks: usize,
    },
    /// The caller asked to stop.
    #[error("stopped while writing {}; the folder is incomplete and is not read as a capture", path.display())]
    Cancelled {
        /// The JSON file.
        path: PathBuf,
    },
}

impl WriteCaptureError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { .. } => ErrorKind::CannotWrite,
            Self::Image(e) => e.kind(),
            Self::BadFrame { .. } | Self::Tracks { .. } => ErrorKind::BadData,
            Self::Cancelled { .. } => ErrorKind::Cancelled,
        }
    }
}
