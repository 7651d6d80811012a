//! Errors of writing a file, common to all formats.

use crate::ErrorKind;
use std::io;
use std::path::{Path, PathBuf};

/// Why a file of another tool could not be written.
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
    /// The scene has values that the format cannot hold, or an option is out of range.
    #[error("the scene cannot be written as {format}: {what}")]
    BadScene {
        /// The format.
        format: &'static str,
        /// The fault, where it is, and how to fix it.
        what: String,
    },
    /// The bytes that were made do not decode to the scene within the declared bounds.
    #[error("the written {format} file does not decode to the scene: {reason}; this is a bug, please report it")]
    Decode {
        /// The format.
        format: &'static str,
        /// What differs, and by how much.
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

    /// The scene does not fit the format.
    pub(crate) fn bad(format: &'static str, what: impl Into<String>) -> Self {
        Self::BadScene {
            format,
            what: what.into(),
        }
    }

    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::BadScene { .. } => ErrorKind::BadData,
            Self::Io { .. } | Self::Verify { .. } | Self::Decode { .. } => ErrorKind::CannotWrite,
        }
    }
}
