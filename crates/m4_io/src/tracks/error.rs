//! Errors of reading tracks.

use crate::ErrorKind;
use crate::shortened;
use std::io;
use std::path::PathBuf;

/// Why a file of tracks could not be read.
#[derive(Debug, thiserror::Error)]
#[error("cannot read the tracks {}: {cause}", path.display(), cause = shortened(cause))]
#[non_exhaustive]
pub struct ReadTracksError {
    /// The file.
    pub path: PathBuf,
    /// The fault.
    pub cause: TracksErrorCause,
}

/// What is wrong with a file of tracks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TracksErrorCause {
    /// The file could not be opened or read.
    #[error("{0}; give the file of the capture, or remove `tracks_path` from the list of frames")]
    Io(io::Error),
    /// It is no zip archive, or a damaged one.
    #[error("it is not an npz archive, or a damaged one ({0}); save it with numpy.savez")]
    Archive(String),
    /// An array is missing.
    #[error("it has no array `{0}`; `coords` and `visibs` are needed")]
    Missing(&'static str),
    /// A member is no array that is read here.
    #[error("its array `{array}` {reason}")]
    Array {
        /// Name of the array.
        array: &'static str,
        /// What is wrong with it and what was expected.
        reason: String,
    },
    /// The tracks are not of this clip.
    #[error("its array `{array}` has shape {found:?} where {expected} was expected", expected = shortened(expected))]
    Shape {
        /// Name of the array.
        array: &'static str,
        /// The shape in the file.
        found: Vec<u64>,
        /// What was expected.
        expected: String,
    },
    /// A coordinate is infinite.
    #[error("track {track} has an infinite position in frame {frame}; unknown positions must be NaN")]
    Infinite {
        /// Index of the frame in the file.
        frame: usize,
        /// Index of the track.
        track: usize,
    },
    /// It would not fit into memory.
    #[error(
        "its array `{array}` takes {needed_bytes} bytes, above the limit of {limit_bytes}; keep fewer tracks, or raise max_memory_bytes"
    )]
    TooLarge {
        /// Name of the array.
        array: &'static str,
        /// What it would take.
        needed_bytes: u64,
        /// The limit.
        limit_bytes: u64,
    },
}

impl ReadTracksError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match &self.cause {
            TracksErrorCause::Io(source) => ErrorKind::of_read(source),
            TracksErrorCause::TooLarge { .. } => ErrorKind::Unsupported,
            TracksErrorCause::Archive(_)
            | TracksErrorCause::Missing(_)
            | TracksErrorCause::Array { .. }
            | TracksErrorCause::Shape { .. }
            | TracksErrorCause::Infinite { .. } => ErrorKind::BadData,
        }
    }
}
