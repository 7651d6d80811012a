//! Errors of reading and writing sparse models.

use crate::ErrorKind;
use crate::cameras::BadName;
use crate::scene::WriteFileError;
use crate::shortened;
use std::io;
use std::path::PathBuf;

/// Why a sparse model could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadColmapError {
    /// A file could not be opened or read.
    #[error("cannot read {}: {source}; a sparse model is a folder with cameras, images and points3D, all .bin or all .txt", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A file ends too early or holds what it cannot.
    #[error("{} is damaged at {place}: {reason}", path.display(), place = shortened(place), reason = shortened(reason))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Line or byte.
        place: String,
        /// The findings.
        reason: String,
    },
    /// A lens with distortion, or one that is unknown.
    #[error("{} has an unsupported camera: {what}; PINHOLE and SIMPLE_PINHOLE are supported (`colmap image_undistorter` writes these)", path.display(), what = shortened(what))]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The model and its parameters.
        what: String,
    },
    /// The files contradict each other.
    #[error("the sparse model {} is inconsistent: {reason}", path.display(), reason = shortened(reason))]
    Inconsistent {
        /// The folder.
        path: PathBuf,
        /// The fault, and where it is.
        reason: String,
    },
}

impl ReadColmapError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } => ErrorKind::of_read(source),
            Self::Unsupported { .. } => ErrorKind::Unsupported,
            Self::Damaged { .. } | Self::Inconsistent { .. } => ErrorKind::BadData,
        }
    }
}

/// Why a sparse model could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteColmapError {
    /// The file did not get to the disk as it was made.
    #[error(transparent)]
    File(#[from] WriteFileError),
    /// The scene has no cameras, or one that is no camera.
    #[error("cannot write {}: {what}", path.display())]
    BadScene {
        /// The folder.
        path: PathBuf,
        /// The fault, and where it is.
        what: String,
    },
    /// The names do not fit.
    #[error("cannot write {}: {source}", path.display())]
    Names {
        /// The folder.
        path: PathBuf,
        /// The fault.
        source: BadName,
    },
}

impl WriteColmapError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::File(e) => e.kind(),
            Self::BadScene { .. } | Self::Names { .. } => ErrorKind::BadData,
        }
    }
}
