//! The last part of a replacement: complete new results take their places.

use super::list::{
    DONE, Files, HIDDEN, Hidden, Kind, LIST, expanded, files_of, listed, with_nested, write_list,
};
use super::{fault, lock};
use crate::{WriteError, WriteFault, atomic};
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Ends a replacement that was interrupted after the new results were complete; for who reads a
/// folder of results.
///
/// # Errors
///
/// [`WriteError`]: another process is at it, or the file system refuses.
pub fn settle(folder: &Path) -> Result<(), WriteError> {
    if complete(folder).is_empty() {
        return Ok(());
    }
    let _lock = lock(folder)?;
    settle_locked(folder)
}

/// The kinds of results in a folder that are complete and not in their places; none where it cannot
/// be read, which its reader reports.
fn complete(folder: &Path) -> Vec<Kind> {
    let names = fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.file_name());
    let kind =
        |name: OsString| Kind::of_name(name.to_str()?.strip_prefix(HIDDEN)?.strip_suffix(DONE)?);
    names.filter_map(kind).collect()
}

pub(super) fn settle_locked(folder: &Path) -> Result<(), WriteError> {
    for kind in complete(folder) {
        let done = kind.done(folder);
        let (new, old) = (files_of(&done, kind), files_of(folder, kind));
        // Until the end, the old and the new ones are ours.
        let old = expanded(folder, &old);
        write_list(folder, kind, &old.union(&new).cloned().collect())?;
        for name in listed(&done, Hidden::Ours)?
            .into_iter()
            .filter(|name| name != LIST)
        {
            check_folders(folder, &name)?;
            let (from, to) = (done.join(&name), folder.join(&name));
            make_parent(&to)?;
            fs::rename(&from, &to).map_err(|e| WriteError::io(&to, e))?;
        }
        remove(folder, &old.difference(&new).cloned().collect())?;
        write_list(folder, kind, &with_nested(new))?;
        remove_folder(&done)?;
        atomic::sync_folder(&done);
    }
    Ok(())
}

/// Refuses a name whose folders are links: the files would lie elsewhere.
pub(super) fn check_folders(folder: &Path, name: &str) -> Result<(), WriteError> {
    let mut path = folder.to_path_buf();
    for part in Path::new(name)
        .parent()
        .into_iter()
        .flat_map(Path::components)
    {
        path.push(part);
        if fs::symlink_metadata(&path).is_ok_and(|kind| !kind.is_dir()) {
            return Err(fault(&path, WriteFault::Foreign));
        }
    }
    Ok(())
}

pub(super) fn make_parent(path: &Path) -> Result<(), WriteError> {
    path.parent().map_or(Ok(()), |parent| {
        fs::create_dir_all(parent).map_err(|e| WriteError::io(parent, e))
    })
}

/// Removes files of ours, and the folders that become empty by that.
pub(super) fn remove(folder: &Path, names: &Files) -> Result<(), WriteError> {
    for name in names {
        if check_folders(folder, name).is_err() {
            continue;
        }
        let path = folder.join(name);
        if let Err(e) = fs::remove_file(&path)
            && e.kind() != ErrorKind::NotFound
        {
            return Err(WriteError::io(&path, e));
        }
    }
    // Longest first: a folder after those in it. One with something else in it stays.
    let parents: BTreeSet<PathBuf> = names
        .iter()
        .flat_map(|name| Path::new(name).ancestors().skip(1))
        .filter(|parent| !parent.as_os_str().is_empty())
        .map(Path::to_path_buf)
        .collect();
    for parent in parents.iter().rev() {
        let _ = fs::remove_dir(folder.join(parent));
    }
    Ok(())
}

pub(super) fn remove_folder(path: &Path) -> Result<(), WriteError> {
    match fs::remove_dir_all(path) {
        Err(e) if e.kind() != ErrorKind::NotFound => Err(WriteError::io(path, e)),
        _ => Ok(()),
    }
}
