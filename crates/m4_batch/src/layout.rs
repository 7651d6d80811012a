//! Where things are in the folder of results.

use std::path::{Path, PathBuf};

/// What a published result says of the job that it belongs to.
pub const RESULT_FILE: &str = "batch.json";
/// A small picture of a result: a frame and its re-render.
pub const POSTER_FILE: &str = "poster.jpg";
/// The record of a run.
pub(crate) const RUN_FILE: &str = "run.json";

/// The folder of results: one folder a clip, and hidden ones for the work itself.
#[derive(Debug, Clone)]
pub struct Layout {
    root: PathBuf,
    scratch: Option<PathBuf>,
}

impl Layout {
    /// Results under `root`; work is done in `scratch`, or in a hidden folder beside the results.
    #[must_use]
    pub fn new(root: &Path, scratch: Option<&Path>) -> Self {
        Self {
            root: root.to_path_buf(),
            scratch: scratch.map(Path::to_path_buf),
        }
    }

    /// The folder of results.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The published result of a clip.
    #[must_use]
    pub fn result(&self, id: &str) -> PathBuf {
        self.root.join(id)
    }

    /// True when work is not done beside the results.
    pub(crate) fn has_scratch(&self) -> bool {
        self.scratch.is_some()
    }

    /// Where a clip's scene is made.
    #[must_use]
    pub fn work(&self, id: &str) -> PathBuf {
        self.scratch
            .as_ref()
            .map_or_else(|| self.root.join(".work"), PathBuf::clone)
            .join(id)
    }

    /// The settings of the run in [`Self::work`].
    pub(crate) fn settings(&self, id: &str) -> PathBuf {
        let folder = self.work(id);
        folder.with_file_name(format!("{id}.toml"))
    }

    /// The leases of a clip.
    #[must_use]
    pub fn leases(&self, id: &str) -> PathBuf {
        self.root.join(".lease").join(id)
    }

    /// What came of a clip.
    #[must_use]
    pub fn state(&self, id: &str) -> PathBuf {
        self.root.join(".state").join(format!("{id}.json"))
    }

    /// What the runs of a clip said.
    #[must_use]
    pub fn log(&self, id: &str) -> PathBuf {
        self.root.join(".log").join(format!("{id}.txt"))
    }

    /// Where a result is copied to before it is published.
    pub(crate) fn incoming(&self, id: &str, nonce: &str) -> PathBuf {
        self.root.join(".incoming").join(format!("{id}-{nonce}"))
    }

    /// Where an older result waits to be removed.
    pub(crate) fn outgoing(&self, id: &str, nonce: &str) -> PathBuf {
        self.root.join(".outgoing").join(format!("{id}-{nonce}"))
    }
}
