//! Errors of reading camera paths.

use crate::ErrorKind;
use crate::shortened;
use std::io;
use std::path::PathBuf;

/// Why a camera path could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadTrajectoryError {
    /// The file could not be opened or read.
    #[error("cannot read the camera path {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The file is not JSON of a known layout.
    #[error("{} is not a camera path: {reason}; give a nerfstudio transforms.json, or keyframes as docs/paths.md describes them", path.display(), reason = shortened(reason))]
    Json {
        /// The file.
        path: PathBuf,
        /// Message of the parser, or what is missing.
        reason: String,
    },
    /// A camera is wrong.
    #[error("{}, camera {camera}: {what}", path.display(), what = shortened(what))]
    BadCamera {
        /// The file.
        path: PathBuf,
        /// Index in the list.
        camera: usize,
        /// The key, what it holds and what was expected.
        what: String,
    },
}

impl ReadTrajectoryError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } => ErrorKind::of_read(source),
            Self::Json { .. } | Self::BadCamera { .. } => ErrorKind::BadData,
        }
    }
}
