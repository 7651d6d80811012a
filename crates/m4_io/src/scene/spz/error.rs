//! Errors of writing SPZ files.

use crate::ErrorKind;
use crate::scene::WriteFileError;
use std::path::PathBuf;

/// Why an SPZ file could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteSpzError {
    /// The file did not get to the disk as it was made.
    #[error(transparent)]
    File(#[from] WriteFileError),
    /// The scene holds something that the format does not.
    #[error("cannot write {}: {what}", path.display())]
    BadScene {
        /// The file.
        path: PathBuf,
        /// The fault, and where it is.
        what: String,
    },
    /// A setting is out of range.
    #[error("cannot write {}: {setting} = {value}; {expected} was expected", path.display())]
    BadOption {
        /// The file.
        path: PathBuf,
        /// The field of [`super::SpzOptions`].
        setting: &'static str,
        /// The value.
        value: String,
        /// What was expected.
        expected: &'static str,
    },
}

impl WriteSpzError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::File(e) => e.kind(),
            Self::BadScene { .. } | Self::BadOption { .. } => ErrorKind::BadData,
        }
    }
}
