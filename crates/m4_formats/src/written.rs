//! What a writer says of its file.

use std::path::PathBuf;

/// What a file holds differently from the scene that it was written from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Loss {
    /// Evaluated at fixed instants: what it was, and at which.
    Baked(String),
    /// Not in the file at all.
    Dropped(String),
    /// Stored with fewer digits: what, and the step or the largest error.
    Quantised(String),
}

impl std::fmt::Display for Loss {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Baked(what) => write!(f, "baked: {what}"),
            Self::Dropped(what) => write!(f, "dropped: {what}"),
            Self::Quantised(what) => write!(f, "quantised: {what}"),
        }
    }
}

/// A file, or a folder of files, that was written and read back.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// The file; for a sequence the folder.
    pub path: PathBuf,
    /// Bytes of all files.
    pub bytes: u64,
    /// Splats in the file; for a sequence the sum over its files.
    pub splats: usize,
    /// What the format could not hold.
    pub losses: Vec<Loss>,
}
