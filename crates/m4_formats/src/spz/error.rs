//! Why an SPZ file could not be read or written.

use crate::WriteFileError;
use m4_io::ErrorKind;
use m4_io::shortened;
use std::io;
use std::path::PathBuf;

/// Why an SPZ file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadSpzError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file is something else.
    #[error("{} is not an SPZ file: {reason}", path.display(), reason = shortened(reason))]
    NotSpz {
        /// The file.
        path: PathBuf,
        /// How that is known.
        reason: String,
    },
    /// A version or a degree that is not read.
    #[error("{} has {what}, and this program reads versions 2 and 3 with harmonics up to degree 3; convert it with `splat-transform IN.spz OUT.ply`", path.display(), what = shortened(what))]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What it has.
        what: String,
    },
    /// The header contradicts the rest, or the stream is broken.
    #[error("{} is damaged: {reason}; copy it again or write it anew", path.display(), reason = shortened(reason))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What was found, and where.
        reason: String,
    },
}

impl ReadSpzError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } => ErrorKind::of_read(source),
            Self::Unsupported { .. } => ErrorKind::Unsupported,
            Self::NotSpz { .. } | Self::Damaged { .. } => ErrorKind::BadData,
        }
    }
}

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
        /// What, and where.
        what: String,
    },
    /// A setting is out of range.
    #[error("cannot write {}: {setting} = {value}; {expected} was expected", path.display())]
    BadOption {
        /// The file.
        path: PathBuf,
        /// The field of [`super::SpzOptions`].
        setting: &'static str,
        /// Its value.
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
