//! Errors of planning, submitting and running jobs.

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
    /// There is a manifest already.
    #[error("{} already exists; --force replaces it", path.display())]
    Exists {
        /// The manifest.
        path: PathBuf,
    },
    /// There is no such clip.
    #[error("there is no video, folder or list at {}", path.display())]
    Missing {
        /// The given value.
        path: PathBuf,
    },
    /// Something was given that cannot be planned.
    #[error("{given} {reason}")]
    Input {
        /// The given value.
        given: String,
        /// What is wrong with it, and what to do.
        reason: &'static str,
    },
    /// The place of a result holds something else.
    #[error("{} exists and was not created by `minute4d batch`; choose another folder with --out, or move it away", path.display())]
    NotOurs {
        /// The folder.
        path: PathBuf,
    },
    /// An index beyond the last job.
    #[error("there is no job {index}: the manifest lists {jobs}, counted from 0")]
    NoSuchJob {
        /// Asked for.
        index: usize,
        /// The number of them.
        jobs: usize,
    },
    /// A variable of the scheduler that is no index.
    #[error("{name}={value:?} is not the index of a job; give --index")]
    Index {
        /// The variable.
        name: &'static str,
        /// The value.
        value: String,
    },
    /// A value that no script can hold.
    #[error("{text:?} cannot be used: {reason}")]
    Text {
        /// The value.
        text: String,
        /// The reason.
        reason: &'static str,
    },
    /// A program of Slurm did not start.
    #[error(
        "cannot start {program}: {source}; submit on a machine that has Slurm, or use --dry-run to write only the script"
    )]
    Start {
        /// The program.
        program: &'static str,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A program of Slurm refused.
    #[error("{program} refused: {message}; the script is {}", script.display())]
    Refused {
        /// The program.
        program: &'static str,
        /// Its message.
        message: String,
        /// The script.
        script: PathBuf,
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

    /// What sort of failure this is.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Read { source, .. } => ErrorKind::of_read(source),
            Self::Write { .. } | Self::Exists { .. } | Self::NotOurs { .. } => ErrorKind::CannotWrite,
            Self::Manifest { .. } | Self::Input { .. } | Self::Text { .. } => ErrorKind::BadData,
            Self::Missing { .. } | Self::NoSuchJob { .. } | Self::Index { .. } | Self::Start { .. } => {
                ErrorKind::NotFound
            }
            Self::Refused { .. } => ErrorKind::Io,
        }
    }
}
