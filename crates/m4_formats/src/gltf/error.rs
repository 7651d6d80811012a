//! Why a glTF file could not be read or written.

use crate::WriteFileError;
use m4_io::ErrorKind;
use m4_io::shortened;
use std::io;
use std::path::PathBuf;

/// Why a glTF file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadGltfError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file is something else.
    #[error("{} is not binary glTF: {reason}", path.display(), reason = shortened(reason))]
    NotGlb {
        /// The file.
        path: PathBuf,
        /// How that is known.
        reason: String,
    },
    /// Splats in a form that is allowed but not read.
    #[error("{} has {what}, which is not read; {instead}", path.display(), what = shortened(what))]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What it has.
        what: String,
        /// What to do.
        instead: &'static str,
    },
    /// The file ends too early or contradicts itself.
    #[error("{} is damaged: {reason}; copy it again or write it anew", path.display(), reason = shortened(reason))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What was found, and where.
        reason: String,
    },
    /// A number that no splat has.
    #[error("splat {splat} of {} has {attribute} = {value}; {expected} was expected", path.display(), attribute = shortened(attribute))]
    BadValue {
        /// The file.
        path: PathBuf,
        /// Its row.
        splat: usize,
        /// The attribute.
        attribute: String,
        /// What it holds.
        value: f32,
        /// What was expected.
        expected: &'static str,
    },
}

impl ReadGltfError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } => ErrorKind::of_read(source),
            Self::Unsupported { .. } => ErrorKind::Unsupported,
            Self::NotGlb { .. } | Self::Damaged { .. } | Self::BadValue { .. } => ErrorKind::BadData,
        }
    }
}

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
        /// What, and what to do.
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
