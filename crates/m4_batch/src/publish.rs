//! From a working folder to a published result: checked, whole, by one rename.

use crate::error::FileError;
use crate::layout::{Layout, RESULT_FILE, RUN_FILE};
use crate::lease::{Lease, random};
use crate::manifest::VERSION;
use crate::record::{read_json, write_json};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::Path;

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

/// What came of publishing.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Published {
    /// It is there.
    Yes,
    /// The job is another's by now; nothing was touched.
    Lost,
    /// The working folder does not hold what its record says.
    Bad(String),
    /// Something that is no result of a batch is where it should go.
    Foreign,
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
    /// No result of a batch.
    Foreign,
}

/// Looks at what is published. File sizes are compared, not hashes: those were when it was published.
pub(crate) fn present(folder: &Path, key: &str) -> Result<Present, FileError> {
    if fs::symlink_metadata(folder).is_err_and(|e| e.kind() == ErrorKind::NotFound) {
        return Ok(Present::None);
    }
    let Some(mark) = read_json::<ResultMark>(&folder.join(RESULT_FILE))?.filter(|m| m.format == FORMAT) else {
        return Ok(Present::Foreign);
    };
    let same = mark.version == VERSION && mark.key == key;
    Ok(if same && check(folder, false)?.is_ok() {
        Present::Same
    } else {
        Present::Other
    })
}

/// Whether a folder holds a finished run whose files are as recorded; what is wrong, where something is.
pub(crate) fn check(folder: &Path, hashes: bool) -> Result<Result<(), String>, FileError> {
    let Some(run) = read_json::<Run>(&folder.join(RUN_FILE))?.filter(|r| r.format == RUN_FORMAT) else {
        return Ok(Err(format!("it has no {RUN_FILE} that can be used")));
    };
    if run.status != "finished" {
        return Ok(Err(format!(
            "its {RUN_FILE} says {:?}, not that it is finished",
            run.status
        )));
    }
    if run.files.is_empty() {
        return Ok(Err(format!("its {RUN_FILE} lists no files")));
    }
    for (name, file) in &run.files {
        let path = folder.join(name);
        let found = match fs::metadata(&path) {
            Ok(found) => found.len(),
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(Err(format!("{name} is missing"))),
            Err(source) => return Err(FileError::Read { path, source }),
        };
        if found != file.bytes {
            return Ok(Err(format!("{name} has {found} bytes and should have {}", file.bytes)));
        }
        if hashes && hash(&path)? != file.blake3 {
            return Ok(Err(format!("{name} is not as it was written")));
        }
    }
    Ok(Ok(()))
}

/// BLAKE3 of a file, hexadecimal.
pub(crate) fn hash(path: &Path) -> Result<String, FileError> {
    let failed = |source| FileError::Read {
        path: path.to_path_buf(),
        source,
    };
    let mut hasher = blake3::Hasher::new();
    hasher
        .update_reader(File::open(path).map_err(failed)?)
        .map_err(failed)?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// Publishes the finished run in the working folder as the result of a job, in place of an older one.
pub(crate) fn publish(layout: &Layout, id: &str, key: &str, host: &str, lease: &Lease) -> Result<Published, FileError> {
    let (work, target) = (layout.work(id), layout.result(id));
    if present(&target, key)? == Present::Foreign {
        return Ok(Published::Foreign);
    }
    if let Err(reason) = check(&work, true)? {
        return Ok(Published::Bad(reason));
    }
    remove_temporary(&work).map_err(FileError::write(&work))?;
    if !lease.confirm()? {
        return Ok(Published::Lost);
    }
    let mark = ResultMark {
        format: FORMAT.to_owned(),
        version: VERSION,
        id: id.to_owned(),
        key: key.to_owned(),
        host: host.to_owned(),
        when_s: crate::record::now_s(),
    };
    write_json(&work.join(RESULT_FILE), &mark)?;
    let nonce = random().map_err(FileError::write(&target))?;
    if !layout.has_scratch() {
        swap(layout, id, &nonce, &work)?;
        return Ok(Published::Yes);
    }
    let incoming = layout.incoming(id, &nonce);
    let copied = copy(&work, &incoming).map_err(FileError::write(&incoming));
    let brought = copied
        .and_then(|()| check(&incoming, true))
        .and_then(|checked| match checked {
            Err(reason) => Ok(Published::Bad(format!("the copy is not what was copied: {reason}"))),
            Ok(()) if !lease.confirm()? => Ok(Published::Lost),
            Ok(()) => swap(layout, id, &nonce, &incoming).map(|()| Published::Yes),
        });
    if !matches!(brought, Ok(Published::Yes)) {
        // Hidden, and of nobody's interest any more.
        let _ = fs::remove_dir_all(&incoming);
    } else {
        // What is left in the scratch folder costs room alone.
        let _ = fs::remove_dir_all(&work);
    }
    brought
}

/// Puts `from` where the result belongs, and an older result out of the way before.
fn swap(layout: &Layout, id: &str, nonce: &str, from: &Path) -> Result<(), FileError> {
    let (target, old) = (layout.result(id), layout.outgoing(id, nonce));
    let failed = |source| FileError::Write {
        path: target.clone(),
        source,
    };
    let replaces = target.exists();
    if replaces {
        if let Some(parent) = old.parent() {
            fs::create_dir_all(parent).map_err(failed)?;
        }
        fs::rename(&target, &old).map_err(failed)?;
    }
    if let Err(error) = fs::rename(from, &target) {
        if replaces {
            // The older result is better than none.
            let _ = fs::rename(&old, &target);
        }
        return Err(failed(error));
    }
    sync_folder(layout.root());
    // Nobody looks there; a part that stays costs room alone.
    let _ = fs::remove_dir_all(old);
    Ok(())
}

/// Not every system lets a folder be opened, and the files are safe by now.
fn sync_folder(folder: &Path) {
    if let Ok(folder) = File::open(folder) {
        let _ = folder.sync_all();
    }
}

/// Files that a killed run was writing.
fn remove_temporary(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let kind = entry.file_type()?;
        let name = entry.file_name();
        if kind.is_dir() {
            remove_temporary(&entry.path())?;
        } else if name.to_str().is_some_and(|n| n.starts_with('.') && n.contains(".tmp-")) {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// Copies a folder; every file is on the disk when this returns.
pub(crate) fn copy(from: &Path, to: &Path) -> io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            copy(&entry.path(), &target)?;
        } else {
            let mut file = File::create(&target)?;
            io::copy(&mut File::open(entry.path())?, &mut file)?;
            file.sync_all()?;
        }
    }
    sync_folder(to);
    Ok(())
}

#[cfg(test)]
mod tests;
