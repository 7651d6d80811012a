//! Publishes the result of a working folder: checked, complete, by one rename.
//!
//! The finished run is brought under a name of its own (`.incoming/ID/NONCE`) before it is checked, so that no process that still writes into
//! the working folder can change what was checked. It appears under its final name by one rename. Of two processes that
//! publish the same job one wins, and the other finds it done.

use crate::batch::error::BatchError;
use crate::batch::layout::{Layout, RESULT_FILE, RUN_FILE, now_s, read_json, write_json};
use crate::batch::manifest::VERSION;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::Path;
use std::time::SystemTime;

/// `format` of [`RESULT_FILE`].
const FORMAT: &str = "minute4d-batch-result";
/// `format` of a run's record.
const RUN_FORMAT: &str = "minute4d-run";

/// [`RESULT_FILE`]: what makes a folder a result of a batch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct ResultMark {
    format: String,
    version: u32,
    id: String,
    key: String,
    host: String,
    when_s: u64,
}

/// What is read of `run.json`.
#[derive(Debug, Deserialize)]
struct Run {
    format: String,
    status: String,
    files: BTreeMap<String, RunFile>,
}

#[derive(Debug, Deserialize)]
struct RunFile {
    bytes: u64,
    blake3: String,
}

/// The outcome of publishing.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Published {
    /// The result is published.
    Yes,
    /// What was made is not what its record says; it was removed.
    Bad(String),
    /// Something that is no result of a batch is where it should go.
    NotOurs,
}

/// What is where a result should be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Present {
    /// Nothing.
    None,
    /// A whole result of the same input and settings.
    Same,
    /// A result of other input or settings, or one that lacks files.
    Other,
    /// A folder that is not a result of a batch.
    NotOurs,
}

/// Checks the published result. File sizes are compared, not hashes: those were when it was published.
pub(crate) fn present(folder: &Path, key: &str) -> Result<Present, BatchError> {
    if fs::symlink_metadata(folder).is_err_and(|e| e.kind() == ErrorKind::NotFound) {
        return Ok(Present::None);
    }
    let Some(mark) = read_json::<ResultMark>(&folder.join(RESULT_FILE))?.filter(|m| m.format == FORMAT) else {
        return Ok(Present::NotOurs);
    };
    let same = mark.version == VERSION && mark.key == key;
    Ok(if same && check(folder, false)?.is_ok() { Present::Same } else { Present::Other })
}

/// Whether a folder holds a finished run whose files are as recorded; what is wrong, where something is.
fn check(folder: &Path, hashes: bool) -> Result<Result<(), String>, BatchError> {
    let Some(run) = read_json::<Run>(&folder.join(RUN_FILE))?.filter(|r| r.format == RUN_FORMAT) else {
        return Ok(Err(format!("it has no {RUN_FILE} that can be used")));
    };
    if run.status != "finished" || run.files.is_empty() {
        let count = run.files.len();
        return Ok(Err(format!("its {RUN_FILE} says {:?}, with {count} files", run.status)));
    }
    for (name, file) in &run.files {
        let path = folder.join(name);
        let found = match fs::metadata(&path) {
            Ok(found) => found.len(),
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(Err(format!("{name} is missing"))),
            Err(source) => return Err(BatchError::Read { path, source }),
        };
        if found != file.bytes {
            return Ok(Err(format!("{name} has {found} bytes and should have {}", file.bytes)));
        }
        if hashes && hash(&path).map_err(BatchError::read(&path))? != file.blake3 {
            return Ok(Err(format!("{name} is not as it was written")));
        }
    }
    Ok(Ok(()))
}

/// BLAKE3 of a file, hexadecimal.
fn hash(path: &Path) -> io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(File::open(path)?)?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// Publishes the finished run in the working folder as the result of a job, instead of an older one.
pub(crate) fn publish(layout: &Layout, id: &str, key: &str, host: &str) -> Result<Published, BatchError> {
    let (work, target) = (layout.work(id), layout.result(id));
    match present(&target, key)? {
        Present::NotOurs => return Ok(Published::NotOurs),
        Present::Same => {
            remove(&work)?;
            return Ok(Published::Yes);
        }
        Present::None | Present::Other => {}
    }
    let nonce = nonce(host);
    let incoming = layout.incoming(id).join(&nonce);
    bring(&work, &incoming).map_err(BatchError::write(&incoming))?;
    if let Err(reason) = check(&incoming, true)? {
        // The next attempt starts again.
        remove(&incoming)?;
        let _ = fs::remove_dir(layout.incoming(id));
        return Ok(Published::Bad(reason));
    }
    mark(&incoming, id, key, host)?;
    swap(layout, id, key, &nonce)?;
    // What stays of these costs room alone.
    let _ = remove(&incoming);
    let _ = remove(&layout.outgoing(id).join(&nonce));
    let _ = fs::remove_dir(layout.incoming(id));
    let _ = fs::remove_dir(layout.outgoing(id));
    Ok(Published::Yes)
}

/// Says whose result a folder is.
fn mark(folder: &Path, id: &str, key: &str, host: &str) -> Result<(), BatchError> {
    let mark = ResultMark {
        format: FORMAT.to_owned(),
        version: VERSION,
        id: id.to_owned(),
        key: key.to_owned(),
        host: host.to_owned(),
        when_s: now_s(),
    };
    write_json(&folder.join(RESULT_FILE), &mark)
}

/// Moves the incoming result into place, after moving an older one away.
fn swap(layout: &Layout, id: &str, key: &str, nonce: &str) -> Result<(), BatchError> {
    let (target, old) = (layout.result(id), layout.outgoing(id).join(nonce));
    let replaces = target.exists();
    if replaces {
        fs::create_dir_all(layout.outgoing(id))
            .and_then(|()| fs::rename(&target, &old))
            .map_err(BatchError::write(&target))?;
    }
    if let Err(error) = fs::rename(layout.incoming(id).join(nonce), &target) {
        if present(&target, key)? == Present::Same {
            // Another process was faster, and has the same result.
            return Ok(());
        }
        if replaces {
            // The older result is better than none.
            let _ = fs::rename(&old, &target);
        }
        return Err(BatchError::write(&target)(error));
    }
    sync_folder(layout.root());
    Ok(())
}

/// Clears up after a process that was killed while it published: a whole result is the working folder again.
pub(crate) fn recover(layout: &Layout, id: &str) -> Result<(), BatchError> {
    remove(&layout.outgoing(id))?;
    let (folder, work) = (layout.incoming(id), layout.work(id));
    let entries = match fs::read_dir(&folder) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(BatchError::read(&folder))?,
    };
    for entry in entries {
        let left = entry.map_err(BatchError::read(&folder))?.path();
        if !work.exists() && check(&left, true)?.is_ok() {
            bring(&left, &work).map_err(BatchError::write(&work))?;
        } else {
            remove(&left)?;
        }
    }
    Ok(())
}

/// Moves a folder, without what a killed run was writing.
fn bring(from: &Path, to: &Path) -> io::Result<()> {
    if let Some(parent) = to.parent() {
        fs::create_dir_all(parent)?;
    }
    fs::rename(from, to)?;
    remove_temporary(to)
}

/// A unique name.
fn nonce(host: &str) -> String {
    let text = format!("{host} {} {:?}", std::process::id(), SystemTime::now());
    blake3::hash(text.as_bytes()).to_hex().chars().take(16).collect()
}

/// Removes a folder that may not be there.
pub(crate) fn remove(folder: &Path) -> Result<(), BatchError> {
    match fs::remove_dir_all(folder) {
        Err(e) if e.kind() != ErrorKind::NotFound => Err(BatchError::write(folder)(e)),
        _ => Ok(()),
    }
}

/// Not every system lets a folder be opened, and the files are safe by now.
fn sync_folder(folder: &Path) {
    if let Ok(folder) = File::open(folder) {
        let _ = folder.sync_all();
    }
}

fn remove_temporary(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name();
        if entry.file_type()?.is_dir() {
            remove_temporary(&entry.path())?;
        } else if name.to_str().is_some_and(|n| n.starts_with('.') && n.contains(".tmp-")) {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
