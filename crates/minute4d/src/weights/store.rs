//! The folder of installed weights, and the comparison of files with their published size and
//! checksum.

use super::{Entry, WeightsError};
use m4_io::files;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::env;
use std::fmt::Write as _;
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use tempfile::{NamedTempFile, TempDir};

/// Record beside a file of weights.
const RECORD: &str = "record.json";

/// The folder that weights lie in, a folder for each name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Store {
    root: PathBuf,
}

/// State of an installed file of weights.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Record {
    /// The entry's name.
    pub name: String,
    /// The file's name.
    pub file: String,
    /// Its size.
    pub bytes: u64,
    /// Its SHA-256, hexadecimal.
    pub sha256: String,
    /// True where size and SHA-256 were compared with published ones.
    pub published: bool,
    /// The licence of the weights.
    pub licence: String,
    /// The source.
    pub source: String,
}

/// Result of [`Store::verify`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Condition {
    /// The file is not here.
    Absent,
    /// Size and SHA-256 are the published ones.
    Published,
    /// Nothing is published to compare with, and the file is as it was when it was added.
    AsAdded,
    /// Nothing is published to compare with, and nothing was recorded.
    Unknown,
    /// The file has changed or is damaged.
    Damaged {
        /// The fault.
        reason: String,
    },
}

impl Store {
    /// The store in the folder `root`.
    pub fn at(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// The store of this user: the folder `MINUTE4D_WEIGHTS`, or `minute4d/weights` in the folder
    /// for caches (`XDG_CACHE_HOME`, `~/.cache`, `LOCALAPPDATA`).
    pub fn of_user() -> Result<Self, WeightsError> {
        let named = |name: &str| {
            env::var_os(name)
                .filter(|v| !v.is_empty())
                .map(PathBuf::from)
        };
        let caches = named("XDG_CACHE_HOME")
            .or_else(|| named("HOME").map(|home| home.join(".cache")))
            .or_else(|| named("LOCALAPPDATA"));
        let root = named("MINUTE4D_WEIGHTS")
            .or_else(|| caches.map(|c| c.join("minute4d").join("weights")));
        Ok(Self {
            root: root.ok_or(WeightsError::NoFolder)?,
        })
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Where `entry` lies in the store, or would.
    pub fn path(&self, entry: &Entry) -> PathBuf {
        self.root.join(entry.name).join(entry.file)
    }

    /// The file of `entry`, if it is here.
    pub fn installed(&self, entry: &Entry) -> Option<PathBuf> {
        Some(self.path(entry)).filter(|path| path.is_file())
    }

    /// The file of `entry`, to be loaded.
    pub fn require(&self, entry: &Entry) -> Result<PathBuf, WeightsError> {
        self.installed(entry).ok_or_else(|| WeightsError::Absent {
            name: entry.name,
            origin: entry.origin.description(),
            without: entry.without,
        })
    }

    /// The record of `entry`; `None` if missing or unreadable.
    pub fn record(&self, entry: &Entry) -> Option<Record> {
        let text = files::read(
            &self.root.join(entry.name).join(RECORD),
            crate::json::MAX_RECORD_BYTES,
        )
        .ok()?;
        serde_json::from_slice(&text).ok()
    }

    /// Reads the file of `entry` again and compares it with what was published, or else recorded.
    pub fn verify(&self, entry: &Entry) -> Result<Condition, WeightsError> {
        let Some(path) = self.installed(entry) else {
            return Ok(Condition::Absent);
        };
        let failed = |source| WeightsError::Read {
            path: path.clone(),
            source,
        };
        let file = files::open(&path).map_err(failed)?;
        let sum = copy(file, io::sink(), None).map_err(|(_, error)| failed(error))?;
        if let Err(error) = compare(entry, &path.display().to_string(), &sum) {
            return Ok(Condition::Damaged {
                reason: error.to_string(),
            });
        }
        if entry.sha256.is_some() {
            return Ok(Condition::Published);
        }
        Ok(match self.record(entry) {
            None => Condition::Unknown,
            Some(record) if record.sha256 == sum.sha256 => Condition::AsAdded,
            Some(record) => Condition::Damaged {
                reason: format!(
                    "SHA-256 {} where {} was recorded",
                    sum.sha256, record.sha256
                ),
            },
        })
    }

    /// A folder that goes away by itself, on the same disk.
    pub(super) fn scratch(&self) -> Result<TempDir, WeightsError> {
        let failed = |source| WeightsError::Write {
            path: self.root.clone(),
            source,
        };
        fs::create_dir_all(&self.root).map_err(failed)?;
        tempfile::Builder::new()
            .prefix(".fetch-")
            .tempdir_in(&self.root)
            .map_err(failed)
    }

    /// Takes `from` (the file `what`, from `source`) as `entry`: it gets its name when all of it is
    /// there and right.
    pub(super) fn take(
        &self,
        entry: &Entry,
        from: impl Read,
        what: &str,
        source: &str,
    ) -> Result<Record, WeightsError> {
        let path = self.path(entry);
        let folder = self.root.join(entry.name);
        let failed = |source| WeightsError::Write {
            path: path.clone(),
            source,
        };
        fs::create_dir_all(&folder).map_err(failed)?;
        let mut file = NamedTempFile::new_in(&folder).map_err(failed)?;
        let sum = copy(from, &mut file, entry.bytes).map_err(|(side, error)| match side {
            Side::Write => failed(error),
            Side::Read => WeightsError::Read {
                path: PathBuf::from(what),
                source: error,
            },
        })?;
        compare(entry, what, &sum)?;
        let record = Record {
            name: entry.name.to_owned(),
            file: entry.file.to_owned(),
            bytes: sum.bytes,
            sha256: sum.sha256,
            published: entry.sha256.is_some(),
            licence: entry.licence.to_owned(),
            source: source.to_owned(),
        };
        let text = serde_json::to_vec_pretty(&record).map_err(|error| failed(error.into()))?;
        file.as_file().sync_all().map_err(failed)?;
        // the record first: a file without one would look like one that nothing is known of
        let mut beside = NamedTempFile::new_in(&folder).map_err(failed)?;
        beside.write_all(&text).map_err(failed)?;
        beside
            .persist(folder.join(RECORD))
            .map_err(|error| failed(error.error))?;
        file.persist(&path).map_err(|error| failed(error.error))?;
        Ok(record)
    }
}

/// Size and SHA-256 of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Sum {
    bytes: u64,
    sha256: String,
}

/// Copies all of `from` to `to` (at most `limit` bytes and one more, which tells that there are too
/// many) and sums it up.
fn copy(from: impl Read, mut to: impl Write, limit: Option<u64>) -> Result<Sum, (Side, io::Error)> {
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
        to.write_all(&buffer[..n])
            .map_err(|error| (Side::Write, error))?;
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
enum Side {
    Read,
    Write,
}

/// Compares `sum` of the file `what` with what `entry` says.
fn compare(entry: &Entry, what: &str, sum: &Sum) -> Result<(), WeightsError> {
    let differs = |expected: String, found: String| {
        WeightsError::Damaged(format!(
            "{what} is not {} as published: {found} where {expected} was expected; nothing was installed",
            entry.name
        ))
    };
    match (entry.bytes, entry.sha256) {
        (Some(bytes), _) if sum.bytes > bytes => {
            Err(differs(format!("{bytes} bytes"), "more".to_owned()))
        }
        (Some(bytes), _) if sum.bytes != bytes => Err(differs(
            format!("{bytes} bytes"),
            format!("{} bytes", sum.bytes),
        )),
        (None, _) if sum.bytes == 0 => Err(differs(
            "a checkpoint".to_owned(),
            "an empty file".to_owned(),
        )),
        (_, Some(sha256)) if sha256 != sum.sha256 => Err(differs(
            format!("SHA-256 {sha256}"),
            format!("SHA-256 {}", sum.sha256),
        )),
        _ => Ok(()),
    }
}
