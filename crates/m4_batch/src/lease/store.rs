//! Leases as files.

use super::Holder;
use crate::error::FileError;
use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// Most bytes of a lease that are read.
const LONGEST: u64 = 4096;

/// A lease as it is found.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Its number; higher ones replace lower ones.
    pub number: u64,
    /// Who has it; `None` while it is being written.
    pub holder: Option<Holder>,
    /// Time since it was last renewed.
    pub age: Duration,
}

impl Seen {
    /// True when it was given back.
    #[must_use]
    pub fn is_released(&self) -> bool {
        self.holder.as_ref().is_some_and(|h| h.released)
    }

    /// True when somebody works under it.
    #[must_use]
    pub fn is_alive(&self, lasts: Duration) -> bool {
        !self.is_released() && self.age <= lasts
    }
}

/// The file of a lease.
pub(super) fn file(folder: &Path, number: u64) -> PathBuf {
    folder.join(format!("{number:06}.json"))
}

/// The content of a lease.
pub(super) fn bytes(holder: &Holder) -> io::Result<Vec<u8>> {
    let mut bytes = serde_json::to_vec(holder)?;
    bytes.push(b'\n');
    Ok(bytes)
}

/// The highest number in the folder.
pub(super) fn highest(folder: &Path) -> Result<Option<u64>, FileError> {
    let entries = match fs::read_dir(folder) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(None),
        entries => entries.map_err(FileError::read(folder))?,
    };
    let mut best = None;
    for entry in entries {
        let name = entry.map_err(FileError::read(folder))?.file_name();
        let number = name
            .to_str()
            .and_then(|n| n.strip_suffix(".json"))
            .and_then(|n| n.parse::<u64>().ok());
        best = best.max(number);
    }
    Ok(best)
}

pub(super) fn newest(folder: &Path) -> Result<Option<Seen>, FileError> {
    let Some(number) = highest(folder)? else {
        return Ok(None);
    };
    let path = file(folder, number);
    // Opened, not only looked at: a shared file system asks its server on opening, and else may answer from memory.
    let mut opened = File::open(&path).map_err(FileError::read(&path))?;
    let mut text = Vec::new();
    (&mut opened)
        .take(LONGEST)
        .read_to_end(&mut text)
        .map_err(FileError::read(&path))?;
    let written = opened
        .metadata()
        .and_then(|m| m.modified())
        .map_err(FileError::read(&path))?;
    Ok(Some(Seen {
        number,
        holder: serde_json::from_slice(&text).ok(),
        age: now_there(folder).duration_since(written).unwrap_or_default(),
    }))
}

/// The time on the clock that the folder's files get theirs from; this machine's where nothing can be written there.
fn now_there(folder: &Path) -> SystemTime {
    let probe = || Passing::write(folder, b"now")?.file.metadata()?.modified();
    probe().unwrap_or_else(|_| SystemTime::now())
}

/// A file with a name of its own that is there for a moment. It has the permissions that any file would have: others of a
/// group must read leases.
struct Passing {
    path: PathBuf,
    file: File,
}

impl Passing {
    fn write(folder: &Path, content: &[u8]) -> io::Result<Self> {
        let path = folder.join(format!(".tmp-{}", random()?));
        let file = File::create_new(&path)?;
        let mut passing = Self { path, file };
        passing.file.write_all(content)?;
        passing.file.sync_all()?;
        Ok(passing)
    }
}

impl Drop for Passing {
    fn drop(&mut self) {
        // Hidden and without meaning: what cannot be removed does no harm.
        let _ = fs::remove_file(&self.path);
    }
}

/// A name that nobody else has.
pub(crate) fn random() -> io::Result<String> {
    let mut bytes = [0; 8];
    getrandom::fill(&mut bytes).map_err(|e| io::Error::other(e.to_string()))?;
    Ok(bytes.iter().map(|b| format!("{b:02x}")).collect())
}

/// Makes the lease of this number, unless somebody has; its content where it is ours and the newest.
pub(super) fn create(folder: &Path, number: u64, me: &Holder) -> Result<Option<Vec<u8>>, FileError> {
    fs::create_dir_all(folder).map_err(FileError::write(folder))?;
    let target = file(folder, number);
    let content = bytes(me).map_err(FileError::write(&target))?;
    if !exclusively(folder, &target, &content).map_err(FileError::write(&target))? {
        return Ok(None);
    }
    // Numbers are never removed, so a higher one was there before ours and counts.
    Ok((highest(folder)? == Some(number)).then_some(content))
}

/// A whole file under a name that nobody had.
fn exclusively(folder: &Path, target: &Path, content: &[u8]) -> io::Result<bool> {
    let whole = Passing::write(folder, content)?;
    match fs::hard_link(&whole.path, target) {
        Ok(()) => Ok(true),
        // The answer to a link that was made may get lost on the way, and then it is there when it is asked for again.
        Err(e) if e.kind() == ErrorKind::AlreadyExists => Ok(fs::read(target)? == content),
        // A file system without links: the file is there before its content is, which readers count as alive.
        Err(_) => match OpenOptions::new().write(true).create_new(true).open(target) {
            Ok(mut file) => file.write_all(content).and_then(|()| file.sync_all()).map(|()| true),
            Err(e) if e.kind() == ErrorKind::AlreadyExists => Ok(false),
            Err(e) => Err(e),
        },
    }
}

/// Writes a lease again, byte by byte what is in it: its time becomes the server's present.
pub(super) fn renew(path: &Path, content: &[u8]) -> io::Result<()> {
    let mut file = OpenOptions::new().write(true).open(path)?;
    file.write_all(content)?;
    file.sync_all()
}
