//! The category of a failure, and the exit code that follows from it.

use m4_io::ErrorKind;

/// The category of a failure, which determines the exit code of the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Category {
    /// An invariant of the program is broken.
    Internal,
    /// An argument is invalid.
    Usage,
    /// An input is damaged, incomplete or inconsistent.
    BadInput,
    /// An input does not exist.
    NoInput,
    /// This machine cannot do the computation: a device, a program or weights are missing or fail, or memory is insufficient.
    NoDevice,
    /// An output cannot be written.
    CannotWrite,
    /// The machine failed while reading.
    Io,
    /// The same command may succeed later.
    TryAgain,
    /// A setting does not exist or has an invalid value.
    BadSettings,
    /// The caller asked to stop; what was finished is kept.
    Stopped,
}

impl Category {
    /// Returns the exit code of this category, after `sysexits.h`. That of [`Category::Stopped`] depends
    /// on the signal; 130 here.
    #[must_use]
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Internal => 1,
            Self::Usage => 2,
            Self::BadInput => 65,
            Self::NoInput => 66,
            Self::NoDevice => 69,
            Self::CannotWrite => 73,
            Self::Io => 74,
            Self::TryAgain => 75,
            Self::BadSettings => 78,
            Self::Stopped => 130,
        }
    }
}

impl From<ErrorKind> for Category {
    fn from(kind: ErrorKind) -> Self {
        match kind {
            ErrorKind::NotFound => Self::NoInput,
            ErrorKind::BadData | ErrorKind::Unsupported => Self::BadInput,
            ErrorKind::BadOption => Self::BadSettings,
            ErrorKind::Unavailable => Self::NoDevice,
            ErrorKind::CannotWrite => Self::CannotWrite,
            ErrorKind::Io => Self::Io,
            ErrorKind::Cancelled => Self::Stopped,
            _ => Self::Internal,
        }
    }
}
