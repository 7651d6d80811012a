//! Errors of writing glTF files.

use crate::ErrorKind;
use crate::scene::WriteFileError;
use std::path::PathBuf;

/// Why a glTF file could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteGltfError {
    /// The file did not get to the disk as it was made.
    #[error(transparent)]
    File(#[from] WriteFileError),
    /// The scene holds something that the format does not.
    #[error("cannot write {}: {what}", path.display())]
    BadScene {
        /// The file.
        path: PathBuf,
        /// The fault, and how to fix it.
        what: String,
    },
}

impl WriteGltfError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::File(e) => e.kind(),
            Self::BadScene { .. } => ErrorKind::BadData,
        }
    }
}
