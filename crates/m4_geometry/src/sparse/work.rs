//! Who hears how far it is, and where finished parts go.

use super::SparseError;
use m4_core::{Cache, NoCache, Progress, kept};
use serde::{Serialize, de::DeserializeOwned};

/// Progress and cache of a long computation.
#[derive(Clone, Copy)]
pub struct Work<'a> {
    /// Receives progress, and may cancel.
    pub progress: &'a dyn Progress,
    /// Keeps finished parts: what is interrupted goes on after the last of them, to the same result. It belongs to one clip
    /// with one set of settings.
    pub cache: &'a dyn Cache,
}

impl<'a> Work<'a> {
    /// Work without a cache.
    #[must_use]
    pub fn new(progress: &'a dyn Progress) -> Self {
        Self {
            progress,
            cache: &NoCache,
        }
    }

    /// Fails once the user asked to stop.
    pub(super) fn stopped(&self) -> Result<(), SparseError> {
        if self.progress.cancelled() {
            Err(SparseError::Cancelled)
        } else {
            Ok(())
        }
    }

    /// A part from the cache, or made and put there. What ends early because the user asked to stop is not kept.
    pub(super) fn part<T: Serialize + DeserializeOwned>(
        &self,
        name: &str,
        make: impl FnOnce() -> Result<T, SparseError>,
    ) -> Result<T, SparseError> {
        kept(self.cache, name, || {
            self.stopped()?;
            let made = make()?;
            self.stopped()?;
            Ok(made)
        })
    }
}
