//! Errors of reading a source.

use crate::image::ReadImageError;
use crate::reach::OutsideError;
use crate::{ErrorKind, shortened};
use std::io;
use std::path::{Path, PathBuf};

/// Why a source could not be read: the file, the place in it, and what to do.
#[derive(Debug, thiserror::Error)]
#[error(
    "cannot import {}{}: {}",
    shortened(path.display()),
    place.as_ref().map(|p| format!(", {}", shortened(p))).unwrap_or_default(),
    shortened(fault)
)]
#[non_exhaustive]
pub struct ReadSourceError {
    /// The file or folder at fault.
    pub path: PathBuf,
    /// The field, line or frame.
    pub place: Option<String>,
    /// The fault.
    pub fault: SourceFault,
}

/// What is wrong with a source.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SourceFault {
    /// The system could not read it.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// Something that the format needs is missing.
    #[error("{what} is missing; {remedy}")]
    Missing {
        /// What.
        what: String,
        /// How to fix it.
        remedy: String,
    },
    /// A value cannot be, or does not fit the others.
    #[error("{what}; {remedy}")]
    Bad {
        /// What it holds and what was expected.
        what: String,
        /// How to fix it.
        remedy: String,
    },
    /// It is in order but is not read here.
    #[error("{what}; {remedy}")]
    Unsupported {
        /// What.
        what: String,
        /// How to fix it.
        remedy: String,
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

impl SourceFault {
    /// Something is missing.
    pub fn missing(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Missing {
            what: what.into(),
            remedy: remedy.into(),
        }
    }

    /// A value cannot be.
    pub fn bad(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Bad {
            what: what.into(),
            remedy: remedy.into(),
        }
    }

    /// Something is not read here.
    pub fn unsupported(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Unsupported {
            what: what.into(),
            remedy: remedy.into(),
        }
    }

    /// The same with the name of a file beside the source, where the message does not have it.
    #[must_use]
    pub fn of_file(self, file: &Path) -> Self {
        let of = |what: String| format!("{}: {what}", file.display());
        match self {
            Self::Io(e) => Self::Io(io::Error::new(e.kind(), of(e.to_string()))),
            Self::Missing { what, remedy } => Self::Missing { what: of(what), remedy },
            Self::Bad { what, remedy } => Self::Bad { what: of(what), remedy },
            Self::Unsupported { what, remedy } => Self::Unsupported { what: of(what), remedy },
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
            fault: self,
        }
    }

    /// With the file and the field, line or frame.
    #[must_use]
    pub fn within(self, path: &Path, place: impl Into<String>) -> ReadSourceError {
        ReadSourceError {
            path: path.to_path_buf(),
            place: Some(place.into()),
            fault: self,
        }
    }
}

impl ReadSourceError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match &self.fault {
            SourceFault::Io(source) => ErrorKind::of_read(source),
            SourceFault::Missing { .. } | SourceFault::Bad { .. } | SourceFault::Outside(_) => ErrorKind::BadData,
            SourceFault::Unsupported { .. } | SourceFault::TooLarge { .. } => ErrorKind::Unsupported,
            SourceFault::Image(source) => source.kind(),
            SourceFault::Cancelled => ErrorKind::Cancelled,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::SourceFault;
    use std::path::Path;

    #[test]
    fn long_quotes_are_shortened_and_keep_the_advice() {
        let fault = SourceFault::bad(format!("{:?} is not a number", "9ü".repeat(100_000)), "correct it");
        let said = fault.within(Path::new("a.txt"), "line 7").to_string();
        assert!(
            said.starts_with("cannot import a.txt, line 7: \"9ü9ü") && said.ends_with("is not a number; correct it")
        );
        assert!(said.chars().count() < 600, "{said}");
    }
}
