//! Errors of the folders and files that are to be written.

use super::Category;
use std::path::PathBuf;

/// Why a folder or file cannot be used as an output, although the system would write it ([`Error::Write`](super::Error::Write) is the other case).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// A file has the name of a folder to create.
    #[error("cannot create the folder {}: a file with that name exists; choose another name", path.display())]
    InTheWay {
        /// The file.
        path: PathBuf,
    },
    /// A folder with other files in it.
    #[error("the folder {} is not empty and not made by minute4d (it has no usable {missing}); choose another folder, or --force to write into it anyway", path.display())]
    NotOurs {
        /// The folder.
        path: PathBuf,
        /// The record that it lacks.
        missing: &'static str,
    },
    /// A folder with earlier work.
    #[error("the folder {} contains {what}; --resume continues it, --force replaces it", path.display())]
    Exists {
        /// The folder.
        path: PathBuf,
        /// What is in it.
        what: &'static str,
    },
    /// A folder that another process uses.
    #[error("another minute4d is using {}; wait for it, or choose another folder", path.display())]
    Busy {
        /// The folder.
        path: PathBuf,
    },
    /// A file that would be replaced.
    #[error("{} already exists; --force replaces it", path.display())]
    WouldReplace {
        /// The file or folder.
        path: PathBuf,
    },
    /// What was written did not read back as it was written.
    #[error("{} was written but does not read back correctly: {what}; check the disk", path.display())]
    Verify {
        /// The file.
        path: PathBuf,
        /// The difference.
        what: String,
    },
}

impl OutputError {
    /// Returns the category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Busy { .. } => Category::TryAgain,
            _ => Category::CannotWrite,
        }
    }
}
