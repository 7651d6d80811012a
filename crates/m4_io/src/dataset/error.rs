//! Errors of reading a source.

use crate::image::ReadImageError;
use crate::reach::OutsideError;
use crate::{ErrorKind, shortened};
use std::io;
use std::path::{Path, PathBuf};

/// Why a source could not be read: the file, the place in it, and what to do.
#[derive(Debug, thiserror::Error)]
#[error(
    "cannot read {}{}: {}",
    shortened(path.display()),
    place.as_ref().map(|p| format!(", {}", shortened(p))).unwrap_or_default(),
    shortened(cause)
)]
#[non_exhaustive]
pub struct ReadSourceError {
    /// The file or folder at fault.
    pub path: PathBuf,
    /// The field, line or frame.
    pub place: Option<String>,
    /// The fault.
    pub cause: SourceErrorCause,
}

/// What is wrong with a source.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SourceErrorCause {
    /// The system could not read it.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// Something that the format needs is missing.
    #[error("{what} is missing; {hint}")]
    Missing {
        /// What.
        what: String,
        /// How to fix it.
        hint: String,
    },
    /// A value cannot be, or does not fit the others.
    #[error("{what}; {hint}")]
    Bad {
        /// What it holds and what was expected.
        what: String,
        /// How to fix it.
        hint: String,
    },
    /// It is in order but is not read here.
    #[error("{what}; {hint}")]
    Unsupported {
        /// What.
        what: String,
        /// How to fix it.
        hint: String,
    },
    /// It would not fit into memory.
    #[error(
        "{what} takes {} MiB of memory, above the limit of {} MiB; take fewer or smaller frames, or raise the limit (max_memory_bytes)",
        needed_bytes >> 20,
        limit_bytes >> 20
    )]
    TooLarge {
        /// The data that need it.
        what: String,
        /// The required memory.
        needed_bytes: u64,
        /// The limit.
        limit_bytes: u64,
    },
    /// A file that the source names lies outside of its folder.
    #[error(transparent)]
    Outside(#[from] Box<OutsideError>),
    /// An image, depth map or mask cannot be decoded.
    #[error(transparent)]
    Image(#[from] ReadImageError),
    /// The caller asked to stop.
    #[error("stopped")]
    Cancelled,
}

impl SourceErrorCause {
    /// Something is missing.
    pub fn missing(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Missing {
            what: what.into(),
            hint: hint.into(),
        }
    }

    /// A value cannot be.
    pub fn bad(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Bad {
            what: what.into(),
            hint: hint.into(),
        }
    }

    /// Something is not read here.
    pub fn unsupported(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Unsupported {
            what: what.into(),
            hint: hint.into(),
        }
    }

    /// The same with the name of a file beside the source, where the message does not have it.
    #[must_use]
    pub fn of_file(self, file: &Path) -> Self {
        self.prefixed(&file.display().to_string())
    }

    /// The same with its place before the message.
    pub(crate) fn prefixed(self, place: &str) -> Self {
        let of = |what: String| format!("{place}: {what}");
        match self {
            Self::Io(e) => Self::Io(io::Error::new(e.kind(), of(e.to_string()))),
            Self::Missing { what, hint } => Self::Missing { what: of(what), hint },
            Self::Bad { what, hint } => Self::Bad { what: of(what), hint },
            Self::Unsupported { what, hint } => Self::Unsupported { what: of(what), hint },
            Self::TooLarge {
                what,
                needed_bytes,
                limit_bytes,
            } => Self::TooLarge {
                what: of(what),
                needed_bytes,
                limit_bytes,
            },
            other @ (Self::Outside(_) | Self::Image(_) | Self::Cancelled) => other,
        }
    }

    /// Adds the file to the fault.
    #[must_use]
    pub fn at(self, path: &Path) -> ReadSourceError {
        ReadSourceError {
            path: path.to_path_buf(),
            place: None,
            cause: self,
        }
    }

    /// With the file and the field, line or frame.
    #[must_use]
    pub fn within(self, path: &Path, place: impl Into<String>) -> ReadSourceError {
        ReadSourceError {
            path: path.to_path_buf(),
            place: Some(place.into()),
            cause: self,
        }
    }
}

impl ReadSourceError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match &self.cause {
            SourceErrorCause::Io(source) => ErrorKind::of_read(source),
            SourceErrorCause::Missing { .. } | SourceErrorCause::Bad { .. } | SourceErrorCause::Outside(_) => {
                ErrorKind::BadData
            }
            SourceErrorCause::Unsupported { .. } | SourceErrorCause::TooLarge { .. } => ErrorKind::Unsupported,
            SourceErrorCause::Image(source) => source.kind(),
            SourceErrorCause::Cancelled => ErrorKind::Cancelled,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::SourceErrorCause;
    use std::path::Path;

    #[test]
    fn long_quotes_are_shortened_and_keep_the_advice() {
        let cause = SourceErrorCause::bad(format!("{:?} is not a number", "9ü".repeat(100_000)), "correct it");
        let message = cause.within(Path::new("a.txt"), "line 7").to_string();
        assert!(
            message.starts_with("cannot read a.txt, line 7: \"9ü9ü")
                && message.ends_with("is not a number; correct it")
        );
        assert!(message.chars().count() < 600, "{message}");
    }
}
