//! Errors of writing a file, common to all formats.

use crate::ErrorKind;
use std::io;
use std::path::{Path, PathBuf};

/// Why a file did not get to the disk as it was made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteFileError {
    /// The file system refused.
    #[error("cannot write {}: {source}; check the permissions and the free space, or choose another folder", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// What was written reads back otherwise; it was removed.
    #[error("{} was written but does not read back ({reason}) and was removed; check the disk", path.display())]
    Verify {
        /// The file or folder.
        path: PathBuf,
        /// The findings.
        reason: String,
    },
}

impl WriteFileError {
    /// The file system refused.
    pub(crate) fn io(path: &Path, source: io::Error) -> Self {
        Self::Io {
            path: path.to_path_buf(),
            source,
        }
    }

    /// What was written reads back otherwise.
    pub(crate) fn verify(path: &Path, reason: impl ToString) -> Self {
        Self::Verify {
            path: path.to_path_buf(),
            reason: reason.to_string(),
        }
    }

    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        ErrorKind::CannotWrite
    }
}
