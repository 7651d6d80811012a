//! The category of a failure, and errors that several operations share: outputs, refusals.

use m4_core::advice::{REPLACE, RESUME};
use m4_io::ErrorKind;
use std::path::{Path, PathBuf};

/// The category of a failure, which determines the exit code of the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Category {
    /// An invariant of the program is broken.
    Internal,
    /// An argument is invalid.
    Usage,
    /// An input is damaged, incomplete or inconsistent.
    BadInput,
    /// An input does not exist.
    NoInput,
    /// This machine cannot do the computation: a device, a program or weights are missing or fail,
    /// or memory is insufficient.
    NoDevice,
    /// An output cannot be written.
    CannotWrite,
    /// The machine failed while reading.
    Io,
    /// The same command may succeed later.
    TryAgain,
    /// A setting does not exist or has an invalid value.
    BadSettings,
    /// The caller asked to stop; what was finished is kept.
    Stopped,
}

impl Category {
    /// Returns the exit code of this category, after `sysexits.h`. That of [`Category::Stopped`]
    /// depends on the signal; 130 here.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Internal => 1,
            Self::Usage => 2,
            Self::BadInput => 65,
            Self::NoInput => 66,
            Self::NoDevice => 69,
            Self::CannotWrite => 73,
            Self::Io => 74,
            Self::TryAgain => 75,
            Self::BadSettings => 78,
            Self::Stopped => 130,
        }
    }
}

impl From<ErrorKind> for Category {
    fn from(kind: ErrorKind) -> Self {
        match kind {
            ErrorKind::NotFound => Self::NoInput,
            ErrorKind::BadData | ErrorKind::Unsupported => Self::BadInput,
            ErrorKind::BadOption => Self::BadSettings,
            ErrorKind::Unavailable => Self::NoDevice,
            ErrorKind::CannotWrite => Self::CannotWrite,
            ErrorKind::Busy => Self::TryAgain,
            ErrorKind::Io => Self::Io,
            ErrorKind::Cancelled => Self::Stopped,
            _ => Self::Internal,
        }
    }
}

/// Why a folder or file cannot be used as an output, although the system would write it
/// ([`Error::Write`](super::Error::Write) is the other case).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// A folder with other files in it.
    #[error("the folder {} is not empty and not made by minute4d (it has no usable {missing}); choose another folder, or {}: other files in it are kept", path.display(), REPLACE)]
    NotOurs {
        /// The folder.
        path: PathBuf,
        /// The record that it lacks.
        missing: &'static str,
    },
    /// A folder with earlier work.
    #[error("the folder {} contains {what}; {}, or {}", path.display(), RESUME, REPLACE)]
    Exists {
        /// The folder.
        path: PathBuf,
        /// What is in it.
        what: String,
    },
    /// A file that would be replaced.
    #[error("{} already exists; choose another name, or {}", path.display(), REPLACE)]
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
    /// Says that `path` would be replaced.
    pub(crate) fn would_replace(path: &Path) -> Self {
        Self::WouldReplace {
            path: path.to_path_buf(),
        }
    }
}

/// A request or an input that cannot be used: what is wrong, where, and what to do next.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
#[non_exhaustive]
pub struct Refusal {
    /// The category of the failure.
    pub category: Category,
    /// The message.
    pub message: String,
}

impl Refusal {
    /// Refuses with a category and a message.
    pub fn new(category: Category, message: impl Into<String>) -> Self {
        Self {
            category,
            message: message.into(),
        }
    }

    /// An argument that is invalid, or that does not go with the others.
    pub fn usage(message: impl Into<String>) -> Self {
        Self::new(Category::Usage, message)
    }

    /// An input that is damaged, incomplete or inconsistent.
    pub fn bad_input(message: impl Into<String>) -> Self {
        Self::new(Category::BadInput, message)
    }
}
