//! Why a USD file could not be read or written.

use crate::WriteFileError;
use m4_io::ErrorKind;
use m4_io::shortened;
use std::io;
use std::path::PathBuf;

/// Why a USD file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadUsdError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file is something else.
    #[error("{} is no USD text: it does not start with #usda; `usdcat IN.usdc -o OUT.usda` makes text of the other forms", path.display())]
    NotUsda {
        /// The file.
        path: PathBuf,
    },
    /// The file ends too early or contradicts itself.
    #[error("{} is damaged: {reason}; copy or export it again", path.display(), reason = shortened(reason))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What was found, and where.
        reason: String,
    },
    /// It uses parts of USD that are not read.
    #[error("{} has {what}; only the layout that `minute4d export` writes is read", path.display(), what = shortened(what))]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What it has.
        what: String,
    },
}

impl ReadUsdError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } => ErrorKind::of_read(source),
            Self::Foreign { .. } => ErrorKind::Unsupported,
            Self::NotUsda { .. } | Self::Damaged { .. } => ErrorKind::BadData,
        }
    }
}

/// Why a USD file could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteUsdError {
    /// The file did not get to the disk as it was made.
    #[error(transparent)]
    File(#[from] WriteFileError),
    /// The name says another form of USD.
    #[error("cannot write {}: USD is written as text, in files that end in .usda; `usdcat` makes .usdc and .usdz of them", path.display())]
    NotText {
        /// The file.
        path: PathBuf,
    },
    /// The scene holds something that the format does not.
    #[error("cannot write {}: {what}", path.display())]
    BadScene {
        /// The file.
        path: PathBuf,
        /// What, and where.
        what: String,
    },
    /// A setting is out of range.
    #[error("cannot write {}: {setting} = {value}; {expected} was expected", path.display())]
    BadOption {
        /// The file.
        path: PathBuf,
        /// The field of [`super::UsdOptions`].
        setting: &'static str,
        /// Its value.
        value: String,
        /// What was expected.
        expected: &'static str,
    },
}

impl WriteUsdError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::File(e) => e.kind(),
            Self::NotText { .. } | Self::BadScene { .. } | Self::BadOption { .. } => ErrorKind::BadData,
        }
    }
}
