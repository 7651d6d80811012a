//! The reports of writers and readers.

use m4_core::Scene;
use std::path::PathBuf;

/// What a file holds differently from the scene that it was written from, or a scene from the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Loss {
    /// Evaluated at fixed instants: what it was, and at which.
    Baked(String),
    /// Missing from the file.
    Dropped(String),
    /// Stored with fewer digits: what, and the step or the largest error.
    Quantised(String),
}

impl Loss {
    /// The Mip filter, for a format that has no place for it; `None` for a scene without one.
    pub(crate) fn of_mip(scene: &Scene) -> Option<Self> {
        let what = "the Mip filter: splats smaller than a pixel are rendered too thick";
        scene.mip.then(|| Self::Dropped(what.to_owned()))
    }
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

/// A scene from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The scene. `source` is empty where the file has no cameras.
    pub scene: Scene,
    /// Unit vector that points up, where the file says so.
    pub up: Option<[f64; 3]>,
    /// What of the file a scene cannot hold.
    pub losses: Vec<Loss>,
}
