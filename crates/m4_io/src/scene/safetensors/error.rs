//! Errors of reading and writing scene files.

use crate::ErrorKind;
use crate::shortened;
use std::io;
use std::path::PathBuf;

/// Why a scene file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadSceneError {
    /// The file could not be opened or read.
    #[error("cannot read the scene {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The file is no safetensors file.
    #[error("{} is not a scene file: {reason}; give the scene.safetensors of a run", path.display(), reason = shortened(reason))]
    NotScene {
        /// The file.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
    /// The file ends too early or its parts overlap.
    #[error("the scene {} is damaged: {reason}; copy it again or use the last checkpoint of the run", path.display(), reason = shortened(reason))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The message of the parser.
        reason: String,
    },
    /// A newer program wrote the file.
    #[error("the scene {} has format version {found}, and this program reads up to {known}; update minute4d", path.display())]
    NewerVersion {
        /// The file.
        path: PathBuf,
        /// Version of the file.
        found: u32,
        /// Newest version that is read.
        known: u32,
    },
    /// The bytes are not those that were written.
    #[error("the scene {} is damaged: its checksum is {found} where {expected} was written; copy it again or use the last checkpoint of the run", path.display(), expected = shortened(expected), found = shortened(found))]
    Checksum {
        /// The file.
        path: PathBuf,
        /// As stored.
        expected: String,
        /// As computed.
        found: String,
    },
    /// An array is missing.
    #[error("the scene {} has no array {name}", path.display(), name = shortened(format!("{name:?}")))]
    MissingArray {
        /// The file.
        path: PathBuf,
        /// Its name.
        name: String,
    },
    /// An array has another type or shape than the rest implies.
    #[error("array {name} of the scene {} is {found} where {expected} was expected", path.display(), name = shortened(format!("{name:?}")), found = shortened(found), expected = shortened(expected))]
    BadArray {
        /// The file.
        path: PathBuf,
        /// Its name.
        name: String,
        /// Type and shape that it has.
        found: String,
        /// Type and shape that it should have.
        expected: String,
    },
}

impl ReadSceneError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } => ErrorKind::of_read(source),
            Self::NewerVersion { .. } => ErrorKind::Unsupported,
            Self::NotScene { .. }
            | Self::Damaged { .. }
            | Self::Checksum { .. }
            | Self::MissingArray { .. }
            | Self::BadArray { .. } => ErrorKind::BadData,
        }
    }
}

/// Why a scene file could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteSceneError {
    /// The file system refused.
    #[error("cannot write the scene {}: {source}; check the folder's permissions and free space", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The scene holds something that the format does not.
    #[error("cannot write the scene {}: {what}", path.display())]
    BadScene {
        /// The file.
        path: PathBuf,
        /// The fault, and where it is.
        what: String,
    },
    /// The file that was written reads back otherwise; it was removed.
    #[error("the scene {} was written but does not read back ({reason}) and was removed; check the disk", path.display())]
    Verify {
        /// The file.
        path: PathBuf,
        /// The findings.
        reason: String,
    },
}

impl WriteSceneError {
    /// Whether the disk or the quota is full: with more room it would be written.
    #[must_use]
    pub fn wants_room(&self) -> bool {
        let full = [io::ErrorKind::StorageFull, io::ErrorKind::QuotaExceeded];
        matches!(self, Self::Io { source, .. } if full.contains(&source.kind()))
    }

    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { .. } | Self::Verify { .. } => ErrorKind::CannotWrite,
            Self::BadScene { .. } => ErrorKind::BadData,
        }
    }
}
