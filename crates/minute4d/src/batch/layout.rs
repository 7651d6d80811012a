//! The layout of the folder of results.

use std::path::{Path, PathBuf};

/// What a published result says of the job that it belongs to.
pub const RESULT_FILE: &str = "batch.json";
/// A small image of a result: a frame and its re-render.
pub const POSTER_FILE: &str = "poster.jpg";
/// The record of a run.
pub(crate) const RUN_FILE: &str = "run.json";

/// The folder of results: one folder per clip, and hidden ones for the work itself.
#[derive(Debug, Clone)]
pub struct Layout {
    root: PathBuf,
}

impl Layout {
    /// Results under `root`.
    #[must_use]
    pub fn new(root: &Path) -> Self {
        let root = root.to_path_buf();
        Self { root }
    }

    /// The folder of results.
    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// The published result of a clip.
    #[must_use]
    pub fn result(&self, id: &str) -> PathBuf {
        self.root.join(id)
    }

    /// Where a clip's scene is made.
    #[must_use]
    pub fn work(&self, id: &str) -> PathBuf {
        self.root.join(".work").join(id)
    }

    /// The settings of the run in [`Self::work`].
    pub(crate) fn settings(&self, id: &str) -> PathBuf {
        self.root.join(".work").join(format!("{id}.toml"))
    }

    /// Locked by the process that runs the job.
    pub(crate) fn lock(&self, id: &str) -> PathBuf {
        self.root.join(".lock").join(id)
    }

    /// The folder of what came of the clips: it is made when a batch is planned, so that it is known whether the results are mounted.
    pub(crate) fn states(&self) -> PathBuf {
        self.root.join(".state")
    }

    /// What came of a clip.
    #[must_use]
    pub fn state(&self, id: &str) -> PathBuf {
        self.states().join(format!("{id}.json"))
    }

    /// Log of the runs of a clip.
    #[must_use]
    pub fn log(&self, id: &str) -> PathBuf {
        self.root.join(".log").join(format!("{id}.txt"))
    }

    /// The folder in which a result is checked before it is published.
    pub(crate) fn incoming(&self, id: &str) -> PathBuf {
        self.root.join(".incoming").join(id)
    }

    /// The folder in which an older result waits to be removed.
    pub(crate) fn outgoing(&self, id: &str) -> PathBuf {
        self.root.join(".outgoing").join(id)
    }
}
