//! Compares a file with its published size and checksum.

use super::{Entry, Store, WeightsError};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Size and SHA-256 of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sum {
    pub bytes: u64,
    pub sha256: String,
}

/// Copies all of `from` to `to` (at most `limit` bytes and one more, which tells that there are too many) and sums it up.
///
/// # Errors
///
/// What reading or writing says; the side is in the first field.
pub fn copy(from: impl Read, mut to: impl Write, limit: Option<u64>) -> Result<Sum, (Side, io::Error)> {
    let mut from = from.take(limit.map_or(u64::MAX, |n| n + 1));
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    let mut bytes = 0;
    loop {
        let n = match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => n,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err((Side::Read, error)),
        };
        hasher.update(&buffer[..n]);
        to.write_all(&buffer[..n]).map_err(|error| (Side::Write, error))?;
        bytes += n as u64;
    }
    let mut sha256 = String::new();
    for byte in hasher.finalize() {
        let _ = write!(sha256, "{byte:02x}");
    }
    Ok(Sum { bytes, sha256 })
}

/// The end of a copy that failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    Read,
    Write,
}

/// Compares `sum` of the file `what` with what `entry` says.
///
/// # Errors
///
/// [`WeightsError::Differs`] with the first difference.
pub fn compare(entry: &Entry, what: &str, sum: &Sum) -> Result<(), WeightsError> {
    let differs = |expected: String, found: String| WeightsError::Differs {
        name: entry.name,
        what: what.to_owned(),
        expected,
        found,
    };
    match entry.bytes {
        Some(bytes) if sum.bytes > bytes => {
            return Err(differs(format!("{bytes} bytes"), "more".to_owned()));
        }
        Some(bytes) if sum.bytes != bytes => {
            return Err(differs(format!("{bytes} bytes"), format!("{} bytes", sum.bytes)));
        }
        None if sum.bytes == 0 => return Err(differs("a checkpoint".to_owned(), "an empty file".to_owned())),
        _ => {}
    }
    match entry.sha256 {
        Some(sha256) if sha256 != sum.sha256 => {
            Err(differs(format!("SHA-256 {sha256}"), format!("SHA-256 {}", sum.sha256)))
        }
        _ => Ok(()),
    }
}

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
        let failed = |source| WeightsError::Write { path: folder.clone(), source };
        fs::create_dir_all(&folder).map_err(failed)?;
        let lock = File::create(folder.join(LOCK)).map_err(failed)?;
        if lock.try_lock().is_ok() {
            return Ok(Self { folder, lock: Some(lock), own: None });
        }
        let own = store.scratch()?;
        Ok(Self { folder: own.path().to_owned(), lock: None, own: Some(own) })
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
        let failed = |source| WeightsError::Write { path: self.folder.clone(), source };
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
