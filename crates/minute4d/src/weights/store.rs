//! The folder of installed weights, and the comparison of files with their published size and
//! checksum.

use super::{Entry, WeightsError};
use crate::json::read_json;
use crate::{Category, Refusal};
use m4_core::Progress;
use m4_io::{atomic, files};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::env;
use std::fmt::Write as _;
use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;
use tempfile::NamedTempFile;

/// Record beside a file of weights.
const RECORD: &str = "record.json";
/// Interval at which a wait for another process looks whether it is over.
const POLL: Duration = Duration::from_millis(50);

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
    /// True where the SHA-256 was compared with a published one: of the registry, or of the host.
    pub published: bool,
    /// The licence of the weights.
    pub licence: String,
    /// The source.
    pub source: String,
    /// The commit that the host said the file is of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub commit: Option<String>,
}

/// Where a file came from, and what was said of it there.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Source {
    pub description: String,
    pub commit: Option<String>,
    /// SHA-256 of the file, hexadecimal; that of a member of an archive is not said.
    pub sha256: Option<String>,
}

/// A folder for a download that is not complete, which no other process has.
#[derive(Debug)]
pub(super) struct Scratch {
    folder: PathBuf,
    /// Locked as long as this lives.
    _lock: File,
}

impl Scratch {
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Removes what has arrived; what cannot be removed is replaced by the next download.
    pub fn remove(self) {
        let _ = fs::remove_dir_all(&self.folder);
    }
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
        read_json(&self.root.join(entry.name).join(RECORD)).ok()?
    }

    /// Reads the file of `entry` again and compares it with what was published, or else recorded.
    pub fn verify(&self, entry: &Entry) -> Result<Condition, WeightsError> {
        let Some(path) = self.installed(entry) else {
            return Ok(Condition::Absent);
        };
        let failed = WeightsError::read(&path);
        let file = files::open(&path).map_err(failed)?;
        let sum = copy((file, failed), (io::sink(), failed), None)?;
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

    /// The folder of the download of `entry`, on the same disk; waits until no other process has
    /// it.
    pub(super) fn scratch(
        &self,
        entry: &Entry,
        progress: &dyn Progress,
    ) -> Result<Scratch, WeightsError> {
        let downloads = self.root.join(".fetch");
        let failed = WeightsError::write(&downloads);
        let folder = downloads.join(entry.name);
        fs::create_dir_all(&folder).map_err(failed)?;
        // beside the folder, and never removed: a lock on a removed file locks nothing
        let lock = File::create(downloads.join(format!("{}.lock", entry.name))).map_err(failed)?;
        loop {
            match lock.try_lock() {
                Ok(()) => break,
                // as some file systems of networks: the file is installed at once in any case
                Err(TryLockError::Error(_)) => break,
                Err(TryLockError::WouldBlock) if progress.cancelled() => {
                    let message = format!("stopped while another process fetches {}", entry.name);
                    return Err(Refusal::new(Category::Stopped, message).into());
                }
                Err(TryLockError::WouldBlock) => thread::sleep(POLL),
            }
        }
        // the other process may have removed it
        fs::create_dir_all(&folder).map_err(failed)?;
        Ok(Scratch {
            folder,
            _lock: lock,
        })
    }

    /// Takes `from` (the file `what`, from `source`) as `entry`: it gets its name when all of it is
    /// there and right.
    pub(super) fn take(
        &self,
        entry: &Entry,
        from: impl Read,
        what: &str,
        source: &Source,
    ) -> Result<Record, WeightsError> {
        let (folder, path) = (self.root.join(entry.name), self.path(entry));
        let failed = WeightsError::write(&path);
        fs::create_dir_all(&folder).map_err(failed)?;
        let mut file = NamedTempFile::new_in(&folder).map_err(failed)?;
        let unreadable = WeightsError::read(Path::new(what));
        let sum = copy((from, unreadable), (&mut file, failed), entry.bytes)?;
        compare(entry, what, &sum)?;
        let source = Source {
            sha256: None,
            ..source.clone()
        };
        self.check_recorded(entry, &sum, &source)?;
        file.as_file().sync_all().map_err(failed)?;
        let record = self.write_record(entry, sum, source)?;
        file.persist(&path).map_err(|error| failed(error.error))?;
        Ok(record)
    }

    /// Moves the complete file `part`, on the same disk, to its place as `entry` if it is right.
    pub(super) fn adopt(
        &self,
        entry: &Entry,
        part: &Path,
        source: Source,
    ) -> Result<Record, WeightsError> {
        let unreadable = WeightsError::read(part);
        let file = files::open(part).map_err(unreadable)?;
        let sum = copy((&file, unreadable), (io::sink(), unreadable), None)?;
        compare(entry, &source.description, &sum)?;
        if let Some(expected) = source.sha256.as_ref().filter(|said| **said != sum.sha256) {
            return Err(differs(
                entry,
                &source.description,
                &format!("SHA-256 {expected}"),
                &format!("SHA-256 {}", sum.sha256),
            ));
        }
        let path = self.path(entry);
        let failed = WeightsError::write(&path);
        self.check_recorded(entry, &sum, &source)?;
        file.sync_all().map_err(failed)?;
        fs::create_dir_all(self.root.join(entry.name)).map_err(failed)?;
        let record = self.write_record(entry, sum, source)?;
        fs::rename(part, &path).map_err(failed)?;
        Ok(record)
    }

    /// Refuses another file from `source`, where it is that of `entry`, than the one that was
    /// trusted when it came first; a file of the user's is the user's choice.
    fn check_recorded(
        &self,
        entry: &Entry,
        sum: &Sum,
        source: &Source,
    ) -> Result<(), WeightsError> {
        match self.record(entry) {
            Some(record)
                if entry.sha256.is_none()
                    && record.source == source.description
                    && record.source == entry.origin.description()
                    && record.sha256 != sum.sha256 =>
            {
                Err(WeightsError::Damaged(format!(
                    "{} is not what it was when {} came from there first: SHA-256 {} where {} was recorded; nothing was \
                     installed. If its authors published another one, remove {} to get it",
                    source.description,
                    entry.name,
                    sum.sha256,
                    record.sha256,
                    self.root.join(entry.name).display()
                )))
            }
            _ => Ok(()),
        }
    }

    /// Writes the record of a file, before the file: one without a record would look like one that
    /// nothing is known of.
    fn write_record(
        &self,
        entry: &Entry,
        sum: Sum,
        source: Source,
    ) -> Result<Record, WeightsError> {
        let path = self.root.join(entry.name).join(RECORD);
        let failed = WeightsError::write(&path);
        let record = Record {
            name: entry.name.to_owned(),
            file: entry.file.to_owned(),
            bytes: sum.bytes,
            sha256: sum.sha256,
            published: entry.sha256.is_some() || source.sha256.is_some(),
            licence: entry.licence.to_owned(),
            source: source.description,
            commit: source.commit,
        };
        let text = serde_json::to_vec_pretty(&record).map_err(|error| failed(error.into()))?;
        atomic::write(&path, &text).map_err(failed)?;
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
///
/// Each end has the error of its failure.
fn copy<R: Read, W: Write>(
    (from, unreadable): (R, impl Fn(io::Error) -> WeightsError),
    (mut to, unwritable): (W, impl Fn(io::Error) -> WeightsError),
    limit: Option<u64>,
) -> Result<Sum, WeightsError> {
    let mut from = from.take(limit.map_or(u64::MAX, |n| n + 1));
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    let mut bytes = 0;
    loop {
        let n = match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => n,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(unreadable(error)),
        };
        hasher.update(&buffer[..n]);
        to.write_all(&buffer[..n]).map_err(&unwritable)?;
        bytes += n as u64;
    }
    let mut sha256 = String::new();
    for byte in hasher.finalize() {
        let _ = write!(sha256, "{byte:02x}");
    }
    Ok(Sum { bytes, sha256 })
}

/// Compares `sum` of the file `what` with what `entry` says.
fn compare(entry: &Entry, what: &str, sum: &Sum) -> Result<(), WeightsError> {
    let differs = |expected: String, actual: String| differs(entry, what, &expected, &actual);
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

fn differs(entry: &Entry, what: &str, expected: &str, actual: &str) -> WeightsError {
    WeightsError::Damaged(format!(
        "{what} is not {} as published: {actual} where {expected} was expected; nothing was installed",
        entry.name
    ))
}
