//! Errors of pretrained weights.

use super::{Category, Refusal};
use m4_io::ErrorKind;
use std::io;
use std::path::{Path, PathBuf};

/// Why weights could not be found, fetched or added.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WeightsError {
    /// Weights that are not installed.
    #[error(
        "the weights {name} are not installed; they come from {origin}. Without them: {without}"
    )]
    Absent {
        /// Their name.
        name: &'static str,
        /// Where their authors publish them.
        origin: String,
        /// What is unavailable without them.
        without: &'static str,
    },
    /// A request that cannot be met: an unknown name, a licence that was not accepted, a host that
    /// refuses or is not reached, a full disk, a stop.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// A file or an archive that is damaged, or not the one that was published.
    #[error("{0}")]
    Damaged(String),
    /// A file could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A file could not be written.
    #[error("cannot write {}: {source}; set MINUTE4D_WEIGHTS to use another folder", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// No folder for weights is known.
    #[error(
        "there is no folder for weights: neither MINUTE4D_WEIGHTS nor XDG_CACHE_HOME, HOME or LOCALAPPDATA is set; set MINUTE4D_WEIGHTS"
    )]
    NoFolder,
}

impl WeightsError {
    /// For `map_err` after a read.
    pub(crate) fn read(path: &Path) -> impl Fn(io::Error) -> Self + Copy {
        |source| Self::Read {
            path: path.to_path_buf(),
            source,
        }
    }

    /// For `map_err` after a write.
    pub(crate) fn write(path: &Path) -> impl Fn(io::Error) -> Self + Copy {
        |source| Self::Write {
            path: path.to_path_buf(),
            source,
        }
    }

    /// Category of the failure.
    pub fn category(&self) -> Category {
        match self {
            Self::Absent { .. } => Category::NoInput,
            Self::Refused(refusal) => refusal.category,
            Self::Damaged(_) => Category::BadInput,
            Self::Read { source, .. } => ErrorKind::of_read(source).into(),
            Self::Write { .. } | Self::NoFolder => Category::CannotWrite,
        }
    }
}
