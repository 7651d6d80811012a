//! Errors of writing `.splatv` files.

use crate::ErrorKind;
use crate::scene::WriteFileError;

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
        /// The fault.
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
