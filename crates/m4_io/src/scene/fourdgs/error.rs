//! Errors of reading `.4dgs` files.

use crate::ErrorKind;
use crate::shortened;
use std::io;
use std::path::PathBuf;

/// Why a `.4dgs` file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadFourdgsError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The file is of another kind, or of a version, model or codec that is not known here.
    #[error("{} cannot be imported: {reason}; write it again as .4dgs version 1 with the model gaussian-birth and deflate streams", path.display(), reason = shortened(reason))]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The statement in the file.
        reason: String,
    },
    /// The file ends too early or contradicts itself.
    #[error("{} is damaged: {reason}; copy or export it again", path.display(), reason = shortened(reason))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The message of the parser.
        reason: String,
    },
    /// The file claims more than it can hold.
    #[error("{} declares splats that need {needed} bytes of memory, and a file of {len} bytes may use {allowed}; it is damaged or malicious", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Memory that decoding would take, bytes.
        needed: u64,
        /// Memory that a file of this size may ask for, bytes.
        allowed: u64,
        /// Size of the file, bytes.
        len: u64,
    },
    /// A number that no splat or camera can have.
    #[error("{} is damaged: {field} of splat {splat} is {value}; export it again", path.display())]
    BadValue {
        /// The file.
        path: PathBuf,
        /// Which splat, in the order of the file.
        splat: usize,
        /// The parameter.
        field: &'static str,
        /// The value in the file.
        value: f32,
    },
}

impl ReadFourdgsError {
    /// What sort of failure this is.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } => ErrorKind::of_read(source),
            Self::Unsupported { .. } => ErrorKind::Unsupported,
            Self::Damaged { .. } | Self::TooLarge { .. } | Self::BadValue { .. } => ErrorKind::BadData,
        }
    }
}
