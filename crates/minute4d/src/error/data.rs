//! Errors of reading and writing videos, images, captures, scenes and cameras.

use super::Category;
use m4_io::{ReadError, WriteError};

/// Why data could not be read or written: the errors of [`m4_io`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DataError {
    /// Reading a file or folder.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Writing a file or folder.
    #[error(transparent)]
    Write(#[from] WriteError),
}

impl DataError {
    /// Returns the category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Read(e) => e.kind().into(),
            Self::Write(e) => e.kind().into(),
        }
    }
}
