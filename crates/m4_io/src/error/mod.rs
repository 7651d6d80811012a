//! Errors of reading and writing.

mod decoder;
mod outside;

pub use decoder::DecoderEnd;
pub use outside::OutsideError;

use std::fmt::Display;
use std::io;
use std::path::{Path, PathBuf};

/// The sort of a failure, from which a program chooses its exit code. Every error of this crate has
/// a method `kind` that returns it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// An input does not exist (exit code 66).
    NotFound,
    /// An input is there but is damaged, incomplete or contradicts itself (65).
    BadData,
    /// An input is fine but needs something that this program does not have (65).
    Unsupported,
    /// An option has a value that it cannot have (78).
    BadOption,
    /// Nothing is known against the input: a program that is needed is missing, or was killed,
    /// hung, or got too little memory (69).
    Unavailable,
    /// An output cannot be made: permissions, a full disk, a path that is in the way (73).
    CannotWrite,
    /// Another process uses an output (75).
    Busy,
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

/// Why a file or folder could not be read: which one, the place in it, what is wrong, and what to
/// do next.
#[derive(Debug, thiserror::Error)]
#[error(
    "cannot read {}{}: {}",
    shortened(path.display()),
    place.as_ref().map(|p| format!(", {}", shortened(p))).unwrap_or_default(),
    shortened(fault)
)]
#[non_exhaustive]
pub struct ReadError {
    /// The file or folder at fault.
    pub path: PathBuf,
    /// The field, line or frame.
    pub place: Option<String>,
    /// What is wrong there.
    pub fault: Fault,
}

impl ReadError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        self.fault.kind()
    }
}

/// What is wrong with a file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    /// The system could not read it.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// It holds, lacks or needs something.
    #[error("{what}; {hint}")]
    Content {
        /// The sort of failure.
        kind: ErrorKind,
        /// What it holds, and what was expected.
        what: String,
        /// How to fix it.
        hint: String,
    },
    /// A file that it names lies outside of its folder.
    #[error(transparent)]
    Outside(#[from] Box<OutsideError>),
    /// Another file that it names cannot be read.
    #[error(transparent)]
    File(#[from] Box<ReadError>),
    /// The process that decodes it failed, perhaps by the fault of the machine.
    #[error("{decoder} failed: {how}; {}", how.advice())]
    Decoder {
        /// Which decoder, for people.
        decoder: &'static str,
        /// How it failed.
        how: DecoderEnd,
    },
    /// The caller asked to stop.
    #[error("stopped")]
    Cancelled,
}

impl From<ReadError> for Fault {
    fn from(error: ReadError) -> Self {
        Self::File(Box::new(error))
    }
}

impl Fault {
    fn content(kind: ErrorKind, what: impl Into<String>, hint: impl Into<String>) -> Self {
        let (what, hint) = (what.into(), hint.into());
        Self::Content { kind, what, hint }
    }

    /// Something that the format needs is missing.
    pub fn missing(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::bad(format!("{} is missing", what.into()), hint)
    }

    /// A value cannot be, or does not fit the others.
    pub fn bad(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::content(ErrorKind::BadData, what, hint)
    }

    /// It ends too early or contradicts itself.
    pub(crate) fn damaged(what: impl Display) -> Self {
        Self::bad(format!("it is damaged: {what}"), "copy or export it again")
    }

    /// It is in order but is not read here.
    pub fn unsupported(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::content(ErrorKind::Unsupported, what, hint)
    }

    /// It needs a program that is not there.
    pub fn unavailable(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::content(ErrorKind::Unavailable, what, hint)
    }

    /// An option cannot have this value.
    pub fn option(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::content(ErrorKind::BadOption, what, hint)
    }

    /// It would not fit into memory.
    #[must_use]
    pub fn too_large(what: &str, needed_bytes: u64, limit_bytes: u64) -> Self {
        let (needed, limit) = (needed_bytes >> 20, limit_bytes >> 20);
        Self::unsupported(
            format!("{what} takes {needed} MiB of memory, above the limit of {limit} MiB"),
            "take fewer or smaller frames, or raise the limit (max_memory_bytes)",
        )
    }

    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io(source) => ErrorKind::of_read(source),
            Self::Content { kind, .. } => *kind,
            Self::Outside(_) => ErrorKind::BadData,
            Self::File(error) => error.kind(),
            Self::Decoder { .. } => ErrorKind::Unavailable,
            Self::Cancelled => ErrorKind::Cancelled,
        }
    }

    /// The fault of the file that names `file`.
    #[must_use]
    pub fn of_file(self, file: &Path) -> Self {
        self.at(file).into()
    }

    /// Adds the file to the fault.
    #[must_use]
    pub fn at(self, path: &Path) -> ReadError {
        match self {
            // it is named already
            Self::File(error) if error.path == path => *error,
            fault => ReadError {
                path: path.to_path_buf(),
                place: None,
                fault,
            },
        }
    }

    /// Adds the file, and the field, line or frame.
    #[must_use]
    pub fn within(self, path: &Path, place: impl Into<String>) -> ReadError {
        let place = Some(place.into());
        ReadError {
            place,
            ..self.at(path)
        }
    }
}

/// Names the file of a fault.
pub(crate) trait AtPath<T> {
    /// The value, or the fault with the file.
    fn at(self, path: &Path) -> Result<T, ReadError>;
}

impl<T, E: Into<Fault>> AtPath<T> for Result<T, E> {
    fn at(self, path: &Path) -> Result<T, ReadError> {
        self.map_err(|fault| fault.into().at(path))
    }
}

/// Why a file or folder could not be written. What was there before is still there, unless the last
/// renames of a folder failed.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {}", path.display(), shortened(fault))]
#[non_exhaustive]
pub struct WriteError {
    /// The file or folder.
    pub path: PathBuf,
    /// What is wrong.
    pub fault: WriteFault,
}

/// Why something could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteFault {
    /// The file system refused.
    #[error("{0}; check the permissions and the free space, or choose another folder")]
    Io(io::Error),
    /// The data hold what the format cannot, or an option is out of range.
    #[error("{0}")]
    Bad(String),
    /// This size, rate or file name is not written.
    #[error("{0}")]
    Unsupported(String),
    /// What was written reads back otherwise.
    #[error("it was written but does not read back ({0}) and was removed; check the disk")]
    Verify(String),
    /// The encoder failed, or made something else than it was given.
    #[error("encoding failed: {0}; this is a bug, please report it")]
    Encode(String),
    /// A file has the name of a folder to create.
    #[error("a file with that name exists; choose another name")]
    InTheWay,
    /// A file has the name of a result, and no list of results names it.
    #[error(
        "no list names it as a result of minute4d, and it would be replaced; move it, or choose another folder"
    )]
    Foreign,
    /// The results would take the place of what they are made from.
    #[error(
        "it is an input of this command and would be replaced; choose another place for the result"
    )]
    Input,
    /// Another process uses the folder.
    #[error("another minute4d is using it; wait for it, or choose another folder")]
    Busy,
    /// The encoder got too little memory.
    #[error(
        "the encoder got too little memory for {0}; end other programs, or choose smaller images"
    )]
    Memory(String),
    /// The caller asked to stop.
    #[error("stopped; what was written is incomplete and is not taken for a whole")]
    Cancelled,
}

impl WriteError {
    fn new(path: &Path, fault: WriteFault) -> Self {
        let path = path.to_path_buf();
        Self { path, fault }
    }

    pub(crate) fn io(path: &Path, source: io::Error) -> Self {
        Self::new(path, WriteFault::Io(source))
    }

    pub(crate) fn bad(path: &Path, what: impl Into<String>) -> Self {
        Self::new(path, WriteFault::Bad(what.into()))
    }

    pub(crate) fn unsupported(path: &Path, what: impl Into<String>) -> Self {
        Self::new(path, WriteFault::Unsupported(what.into()))
    }

    pub(crate) fn verify(path: &Path, reason: impl ToString) -> Self {
        Self::new(path, WriteFault::Verify(reason.to_string()))
    }

    pub(crate) fn encode(path: &Path, reason: impl ToString) -> Self {
        Self::new(path, WriteFault::Encode(reason.to_string()))
    }

    pub(crate) fn memory(path: &Path, of: impl ToString) -> Self {
        Self::new(path, WriteFault::Memory(of.to_string()))
    }

    pub(crate) fn cancelled(path: &Path) -> Self {
        Self::new(path, WriteFault::Cancelled)
    }

    /// Whether the disk or the quota is full: with more room it would be written.
    #[must_use]
    pub fn wants_room(&self) -> bool {
        let full = [io::ErrorKind::StorageFull, io::ErrorKind::QuotaExceeded];
        matches!(&self.fault, WriteFault::Io(source) if full.contains(&source.kind()))
    }

    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match &self.fault {
            WriteFault::Io(_)
            | WriteFault::Verify(_)
            | WriteFault::Encode(_)
            | WriteFault::InTheWay
            | WriteFault::Foreign
            | WriteFault::Input => ErrorKind::CannotWrite,
            WriteFault::Busy => ErrorKind::Busy,
            WriteFault::Bad(_) => ErrorKind::BadData,
            WriteFault::Unsupported(_) => ErrorKind::Unsupported,
            WriteFault::Memory(_) => ErrorKind::Unavailable,
            WriteFault::Cancelled => ErrorKind::Cancelled,
        }
    }
}

/// Letters of a quotation at most.
const MAX_LETTERS: usize = 400;

/// What a message quotes of a file, which may be megabytes: whole where it is short, else its start
/// and its end.
#[must_use]
pub fn shortened(part: impl Display) -> String {
    let text = part.to_string();
    if text.chars().nth(MAX_LETTERS).is_none() {
        return text;
    }
    let start = text
        .char_indices()
        .nth(MAX_LETTERS / 2)
        .map_or(text.len(), |(at, _)| at);
    let end = text
        .char_indices()
        .rev()
        .nth(MAX_LETTERS / 2 - 1)
        .map_or(0, |(at, _)| at);
    format!("{} ... {}", &text[..start], &text[end..])
}

#[cfg(test)]
mod tests {
    use super::{Fault, shortened};
    use std::path::Path;

    #[test]
    fn long_quotes_are_shortened_and_keep_the_advice() {
        let fault = Fault::bad(
            format!("{:?} is not a number", "9ü".repeat(100_000)),
            "correct it",
        );
        let message = fault.within(Path::new("a.txt"), "line 7").to_string();
        assert!(
            message.starts_with("cannot read a.txt, line 7: \"9ü9ü")
                && message.ends_with("is not a number; correct it")
        );
        assert!(message.chars().count() < 600, "{message}");
    }

    #[test]
    fn short_text_stays_and_long_text_keeps_start_and_end() {
        for n in [0, 1, 3, 399, 400] {
            let text = "ü".repeat(n);
            assert_eq!(shortened(&text), text);
        }
        let long = format!("start{}end; do this", "9ü".repeat(1_000_000));
        let message = shortened(&long);
        assert!(
            message.starts_with("start9ü9ü") && message.ends_with("9üend; do this"),
            "{message}"
        );
        assert_eq!(message.chars().count(), 405);
    }
}
