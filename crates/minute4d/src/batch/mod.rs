//! Batches of clips: planning, running one job, and reporting the results.
//!
//! A [`Manifest`] lists the clips and holds the settings. A scheduler starts one process a job ([`run_job`]): it has a child process
//! make the scene in a working folder, and publishes the whole result by one rename. Which machine does what, and what is started
//! again, is the scheduler's business; [`slurm`] submits to one. All that is known afterwards ([`Report`]) is read from the results.

mod child;
mod job;
mod layout;
mod manifest;
mod plan;
mod publish;
mod report;
pub mod slurm;

pub use child::Watch;
pub use job::{INDEX_VARIABLES, JobEnd, Tools, index_of_environment, run_job};
pub use layout::{JobRecord, Layout, Outcome, POSTER_FILE, RESULT_FILE};
pub use manifest::{Arguments, FORMAT, Job, Manifest, VERSION};
pub use plan::{Plan, plan};
pub use report::{ClipReport, ClipState, Report, page};

use m4_io::ErrorKind;
use std::io;
use std::path::{Path, PathBuf};

/// Why a command of a batch could not do its work. What goes wrong with a clip is no such error: it is recorded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BatchError {
    /// A file was not read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The path.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A file was not written.
    #[error("cannot write {}: {source}; check the permissions and the free space", path.display())]
    Write {
        /// The path.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A file that is no manifest, or a damaged one.
    #[error("{}: {reason}; create the manifest again with `minute4d batch plan`", path.display())]
    Manifest {
        /// The manifest.
        path: PathBuf,
        /// What is wrong with it, and in which line.
        reason: String,
    },
    /// A request, an input or a scheduler that cannot be used.
    #[error("{message}")]
    Refused {
        /// The sort of failure.
        kind: ErrorKind,
        /// What is wrong, and what to do next.
        message: String,
    },
}

impl BatchError {
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

    /// A failure of this sort.
    pub(crate) fn refused(kind: ErrorKind, message: impl Into<String>) -> Self {
        Self::Refused { kind, message: message.into() }
    }

    /// Results would go to a folder that holds something else.
    pub(crate) fn not_ours(path: &Path) -> Self {
        let message = format!(
            "{} exists and was not created by `minute4d batch`; choose another folder with --out, or move it away",
            path.display()
        );
        Self::refused(ErrorKind::CannotWrite, message)
    }

    /// What sort of failure this is.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Read { source, .. } => ErrorKind::of_read(source),
            Self::Write { .. } => ErrorKind::CannotWrite,
            Self::Manifest { .. } => ErrorKind::BadData,
            Self::Refused { kind, .. } => *kind,
        }
    }
}
