//! Why a `.splatv` file could not be read or written.

use crate::WriteFileError;
use m4_io::ErrorKind;
use m4_io::shortened;
use std::io;
use std::path::PathBuf;

/// Why a `.splatv` file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadSplatvError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file is of another kind.
    #[error("{} is not a .splatv file: {reason}; check the name, or import it as another format", path.display(), reason = shortened(reason))]
    NotSplatv {
        /// The file.
        path: PathBuf,
        /// How that is known.
        reason: String,
    },
    /// The file ends too early or contradicts itself.
    #[error("{} is damaged: {reason}; copy or export it again", path.display(), reason = shortened(reason))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What was found.
        reason: String,
    },
    /// A number that no splat can have.
    #[error("{} is damaged: {field} of splat {splat} is {value}; export it again", path.display())]
    BadValue {
        /// The file.
        path: PathBuf,
        /// Which splat, in the order of the file.
        splat: usize,
        /// Which of its parameters.
        field: &'static str,
        /// As found.
        value: f32,
    },
}

impl ReadSplatvError {
    /// What sort of failure this is.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } => ErrorKind::of_read(source),
            Self::NotSplatv { .. } | Self::Damaged { .. } | Self::BadValue { .. } => ErrorKind::BadData,
        }
    }
}

/// Why a `.splatv` file could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteSplatvError {
    /// The file did not get to the disk as it was made.
    #[error(transparent)]
    File(#[from] WriteFileError),
    /// The scene has values that no file can hold.
    #[error("the scene cannot be written as .splatv: {reason}")]
    BadScene {
        /// What is wrong with it.
        reason: String,
    },
}

impl WriteSplatvError {
    /// What sort of failure this is.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::File(e) => e.kind(),
            Self::BadScene { .. } => ErrorKind::BadData,
        }
    }
}
