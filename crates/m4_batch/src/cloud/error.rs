//! Why an object store could not be used.

use crate::error::FileError;
use m4_io::ErrorKind;

/// Why an object store could not be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CloudError {
    /// The program has no code for it.
    #[error(
        "{uri} is in an object store, and this program was built without them; build it with `--features cloud`, or copy the \
         clips to a folder that all workers see"
    )]
    Without {
        /// What was given.
        uri: String,
    },
    /// It names nothing that can be used.
    #[error("{uri} cannot be used: {reason}")]
    Uri {
        /// What was given.
        uri: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Nothing is there.
    #[error("there is no object {uri}; a prefix, whose videos are all meant, ends with /")]
    NotFound {
        /// What was asked for.
        uri: String,
    },
    /// No video is under a prefix.
    #[error("{uri} holds no video{}", if *recursive { "" } else { "; --recursive looks into prefixes in it" })]
    Nothing {
        /// The prefix.
        uri: String,
        /// Whether prefixes in it were looked into.
        recursive: bool,
    },
    /// The store tells nothing by which a change would be noticed.
    #[error("{uri} has neither an ETag nor a version, so that a change would go unnoticed; copy it to a folder")]
    NoEtag {
        /// The object.
        uri: String,
    },
    /// It is not what was planned.
    #[error("{uri} changed since it was planned ({reason}); plan again")]
    Changed {
        /// The object.
        uri: String,
        /// What differs.
        reason: String,
    },
    /// The store does not let us.
    #[error("{uri} is refused to us: {reason}; check the credentials in the environment")]
    Denied {
        /// What was asked for.
        uri: String,
        /// What the store said.
        reason: String,
    },
    /// The store, or the way to it, failed.
    #[error("{uri}: {reason}; check the network and the settings of the store in the environment, and try again")]
    Store {
        /// What was asked for.
        uri: String,
        /// What happened.
        reason: String,
    },
    /// This machine failed.
    #[error(transparent)]
    File(#[from] FileError),
    /// Whoever asked did not want it any more.
    #[error("{uri}: this worker was asked to stop")]
    Stopped {
        /// What was being copied.
        uri: String,
    },
}

impl CloudError {
    /// What sort of failure this is.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Without { .. } => ErrorKind::Unsupported,
            Self::Uri { .. } | Self::Nothing { .. } | Self::NoEtag { .. } | Self::Changed { .. } => ErrorKind::BadData,
            Self::NotFound { .. } => ErrorKind::NotFound,
            Self::Denied { .. } | Self::Store { .. } => ErrorKind::Io,
            Self::File(error) => error.kind(),
            Self::Stopped { .. } => ErrorKind::Cancelled,
        }
    }
}
