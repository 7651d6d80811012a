//! Errors of reading MegaSaM's files.

use crate::ErrorKind;
use crate::npy::ArrayFault;
use crate::shortened;
use std::io;
use std::path::PathBuf;

/// Why a file or folder of MegaSaM could not be read.
#[derive(Debug, thiserror::Error)]
#[error("cannot read {} as output of MegaSaM: {fault}", path.display(), fault = shortened(fault))]
#[non_exhaustive]
pub struct ReadMegasamError {
    /// The file.
    pub path: PathBuf,
    /// The fault.
    pub fault: MegasamFault,
}

/// What is wrong with a file of MegaSaM.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MegasamFault {
    /// The file could not be opened or read.
    #[error("{0}; give a NAME_droid.npz, a NAME_sgd_cvd_hr.npz or a folder of reconstructions")]
    Io(io::Error),
    /// It is no zip archive, or a damaged one.
    #[error("it is not an npz archive, or a damaged one ({0}); copy it again, or run MegaSaM again")]
    Archive(String),
    /// An array is missing.
    #[error("it has no array `{array}` ({has})")]
    Missing {
        /// Name of the array.
        array: &'static str,
        /// Which are there, and which are needed.
        has: String,
    },
    /// A member is no array that is read here.
    #[error("the array `{array}` {reason}", reason = shortened(reason))]
    Array {
        /// Name of the array.
        array: &'static str,
        /// What is wrong with it and what was expected.
        reason: String,
    },
    /// An array has another shape than the others ask for.
    #[error("the array `{array}` has shape {found:?} where {expected} was expected", expected = shortened(expected))]
    Shape {
        /// Name of the array.
        array: &'static str,
        /// The shape in the file.
        found: Vec<usize>,
        /// What was expected.
        expected: String,
    },
    /// A number cannot be.
    #[error("the array `{array}`, frame {frame}: {what}", what = shortened(what))]
    Value {
        /// Name of the array.
        array: &'static str,
        /// Index of the frame.
        frame: usize,
        /// What it holds and what was expected.
        what: String,
    },
    /// An option has no meaning.
    #[error("{option} = {value}: {expected}")]
    Option {
        /// The option.
        option: &'static str,
        /// The value.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// It would not fit into memory.
    #[error("{what} takes {} MiB of memory, above the limit of {} MiB; shorten the clip, or raise the limit (max_memory_bytes)",
        needed_bytes >> 20,
        limit_bytes >> 20, what = shortened(what))]
    TooLarge {
        /// The data that need it.
        what: String,
        /// The required memory.
        needed_bytes: u64,
        /// The limit.
        limit_bytes: u64,
    },
    /// The caller asked to stop.
    #[error("stopped")]
    Cancelled,
}

impl MegasamFault {
    /// A fault of the array of that name.
    pub(super) fn of(array: &'static str) -> impl Fn(ArrayFault) -> Self {
        move |fault| match fault {
            ArrayFault::Bad(reason) => Self::Array { array, reason },
            ArrayFault::TooLarge {
                needed_bytes,
                limit_bytes,
            } => Self::TooLarge {
                what: format!("the array `{array}`"),
                needed_bytes,
                limit_bytes,
            },
        }
    }
}

impl ReadMegasamError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match &self.fault {
            MegasamFault::Io(source) => ErrorKind::of_read(source),
            MegasamFault::TooLarge { .. } => ErrorKind::Unsupported,
            MegasamFault::Cancelled => ErrorKind::Cancelled,
            MegasamFault::Archive(_)
            | MegasamFault::Missing { .. }
            | MegasamFault::Array { .. }
            | MegasamFault::Shape { .. }
            | MegasamFault::Value { .. }
            | MegasamFault::Option { .. } => ErrorKind::BadData,
        }
    }
}
