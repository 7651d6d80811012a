//! Errors of reading PLY files.

use crate::ErrorKind;
use crate::shortened;
use std::io;
use std::path::PathBuf;

/// Why a PLY file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadPlyError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The file is of another kind.
    #[error("{} is not a PLY file: {reason}; check the name, or import it as another format", path.display(), reason = shortened(reason))]
    NotPly {
        /// The file.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
    /// A PLY file without splats, or with splats in a layout that is not known here.
    #[error("{} cannot be imported: {reason}; give a PLY file of splats as 3DGS writes it", path.display(), reason = shortened(reason))]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What is missing or not known.
        reason: String,
    },
    /// The header makes no sense, or the file ends too early.
    #[error("{} is damaged: {reason}; copy or export it again", path.display(), reason = shortened(reason))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The findings.
        reason: String,
    },
    /// A number that no splat can have.
    #[error("{} is damaged: {property} of splat {splat} is {value}; export it again", path.display(), property = shortened(property))]
    BadValue {
        /// The file.
        path: PathBuf,
        /// Which splat, in the order of the file.
        splat: usize,
        /// The property.
        property: String,
        /// The value in the file.
        value: f32,
    },
}

impl ReadPlyError {
    /// What sort of failure this is.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } => ErrorKind::of_read(source),
            Self::Unsupported { .. } => ErrorKind::Unsupported,
            Self::NotPly { .. } | Self::Damaged { .. } | Self::BadValue { .. } => ErrorKind::BadData,
        }
    }
}
