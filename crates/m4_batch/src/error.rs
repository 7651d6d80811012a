//! Why planning, reading a manifest and working may fail.

use m4_io::ErrorKind;
use std::io;
use std::path::{Path, PathBuf};

/// A file of a batch could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// Not read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// What was to be read.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Not written.
    #[error("cannot write {}: {source}; check the permissions and the free space", path.display())]
    Write {
        /// What was to be written.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

impl FileError {
    /// For `map_err` after a read.
    pub(crate) fn read(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        |source| Self::Read { path, source }
    }

    /// For `map_err` after a write.
    pub(crate) fn write(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        |source| Self::Write { path, source }
    }

    /// What sort of failure this is.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Read { source, .. } => ErrorKind::of_read(source),
            Self::Write { .. } => ErrorKind::CannotWrite,
        }
    }
}

/// Why a manifest could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ManifestError {
    /// The file system refused.
    #[error(transparent)]
    File(#[from] FileError),
    /// There is one already.
    #[error("{} is already there; --force replaces it", path.display())]
    Exists {
        /// The manifest.
        path: PathBuf,
    },
    /// A line that is not what it should be.
    #[error("{}, line {line}: {reason}; make the manifest again with `minute4d batch plan`", path.display())]
    Line {
        /// The manifest.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// The whole does not fit together.
    #[error("{}: {reason}; make the manifest again with `minute4d batch plan`", path.display())]
    Whole {
        /// The manifest.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
}

impl ManifestError {
    /// What sort of failure this is.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::File(error) => error.kind(),
            Self::Exists { .. } => ErrorKind::CannotWrite,
            Self::Line { .. } | Self::Whole { .. } => ErrorKind::BadData,
        }
    }
}

/// Why no plan could be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The file system refused.
    #[error(transparent)]
    File(#[from] FileError),
    /// Nothing is there.
    #[error("there is no video, folder or list at {}", path.display())]
    Missing {
        /// What was given.
        path: PathBuf,
    },
    /// A pattern that is none.
    #[error("{pattern:?} is not a pattern that can be used: {reason}")]
    Pattern {
        /// What was given.
        pattern: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Nothing was found.
    #[error("{given} holds no video{}", if *recursive { "" } else { "; --recursive looks into folders in it" })]
    Nothing {
        /// What was given.
        given: String,
        /// Whether folders were looked into.
        recursive: bool,
    },
    /// JSON holds text alone.
    #[error("the name {} is not UTF-8, which a manifest cannot hold; rename it", path.display())]
    Name {
        /// The input.
        path: PathBuf,
    },
    /// The input could not be hashed.
    #[error("cannot read {}: {reason}", path.display())]
    Hash {
        /// The input.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// An address of an object store or a web server.
    #[error("{given} is an address, not a path; mount the store as a folder, or download the clip first")]
    Address {
        /// What was given.
        given: String,
    },
    /// Something of another kind is where a result is to be.
    #[error("{} is there and was not made by `minute4d batch`; choose another folder with --out, or move it away", path.display())]
    Foreign {
        /// The folder.
        path: PathBuf,
    },
}

impl PlanError {
    /// What sort of failure this is.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::File(error) => error.kind(),
            Self::Missing { .. } => ErrorKind::NotFound,
            Self::Foreign { .. } => ErrorKind::CannotWrite,
            Self::Hash { .. } => ErrorKind::Io,
            Self::Pattern { .. } | Self::Nothing { .. } | Self::Name { .. } | Self::Address { .. } => {
                ErrorKind::BadData
            }
        }
    }
}

/// Why a worker could not go on at all. What goes wrong with a clip is recorded, and no error of the worker.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WorkError {
    /// The file system refused.
    #[error(transparent)]
    File(#[from] FileError),
    /// An index beyond the last clip.
    #[error("there is no job {index}: the manifest lists {jobs}, counted from 0")]
    NoSuchJob {
        /// Asked for.
        index: usize,
        /// How many there are.
        jobs: usize,
    },
    /// A variable of the engine that is no number.
    #[error("{name}={value:?} is not the number of a job; give --index")]
    Index {
        /// The variable.
        name: &'static str,
        /// Its value.
        value: String,
    },
}

impl WorkError {
    /// What sort of failure this is.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::File(error) => error.kind(),
            Self::NoSuchJob { .. } | Self::Index { .. } => ErrorKind::NotFound,
        }
    }
}
