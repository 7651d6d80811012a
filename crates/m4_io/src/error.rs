//! The kinds of failure, from which a program chooses its exit code.

use std::io;

/// The sort of a failure. Every error of this crate has a method `kind` that returns it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// An input does not exist (exit code 66).
    NotFound,
    /// An input is there but is damaged, incomplete or contradicts itself (65).
    BadData,
    /// An input is fine but needs something that this program does not have (65).
    Unsupported,
    /// Nothing is known against the input: a program that is needed is missing, or was killed, hung, or got too little memory (69).
    Unavailable,
    /// An output cannot be made: permissions, a full disk, a path that is in the way (73).
    CannotWrite,
    /// The machine failed while reading (74).
    Io,
    /// The caller asked to stop.
    Cancelled,
}

impl ErrorKind {
    /// The sort of a failed read.
    #[must_use]
    pub fn of_read(error: &io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => Self::NotFound,
            io::ErrorKind::UnexpectedEof | io::ErrorKind::InvalidData => Self::BadData,
            _ => Self::Io,
        }
    }
}
