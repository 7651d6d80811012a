//! The folder that keeps a downloaded archive until its weights are in the store.

use super::{Entry, Store, WeightsError};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The file by which two programs that fetch the same keep out of each other's way.
const LOCK: &str = "lock";

/// A folder of one fetch, on the disk of the store.
#[derive(Debug)]
pub struct Partial {
    folder: PathBuf,
    /// Held while it is this program's.
    lock: Option<File>,
    /// The folder itself where another program holds the usual one.
    own: Option<TempDir>,
}

impl Partial {
    /// That of `entry`, with what an earlier fetch left there.
    ///
    /// # Errors
    ///
    /// [`WeightsError::Write`] if there can be none.
    pub fn of(store: &Store, entry: &Entry) -> Result<Self, WeightsError> {
        let folder = store.root().join(format!(".fetch-{}", entry.name));
        let failed = |source| WeightsError::Write {
            path: folder.clone(),
            source,
        };
        fs::create_dir_all(&folder).map_err(failed)?;
        let lock = File::create(folder.join(LOCK)).map_err(failed)?;
        if lock.try_lock().is_ok() {
            return Ok(Self {
                folder,
                lock: Some(lock),
                own: None,
            });
        }
        let own = store.scratch()?;
        Ok(Self {
            folder: own.path().to_owned(),
            lock: None,
            own: Some(own),
        })
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Removes what is in it.
    ///
    /// # Errors
    ///
    /// [`WeightsError::Write`] if that fails.
    pub fn empty(&self) -> Result<(), WeightsError> {
        let failed = |source| WeightsError::Write {
            path: self.folder.clone(),
            source,
        };
        for file in fs::read_dir(&self.folder).map_err(failed)? {
            let path = file.map_err(failed)?.path();
            if path.file_name().is_some_and(|name| name != LOCK) {
                fs::remove_file(&path).map_err(failed)?;
            }
        }
        Ok(())
    }

    /// Removes it. What cannot be removed is overwritten by the next fetch.
    pub fn remove(mut self) {
        if self.own.take().is_none() {
            let _ = fs::remove_dir_all(&self.folder);
        }
        drop(self.lock.take());
    }
}
