//! Folders of results: which of their files are ours, and how new results take the place of old
//! ones.
//!
//! ```text
//! .minute4d-files.json     for each kind of results the files that were written here, and the names that a command at work may use
//! .minute4d-KIND-next/     new results while they are made; a killed process leaves it, and what was there before is whole
//! .minute4d-KIND-done/     complete new results that take their places: the next command that opens the folder ends that
//! ```
//!
//! Only files that the list names for the same kind are ever removed or replaced. A folder without
//! a list has none of ours.

mod list;
mod settle;
#[cfg(test)]
mod tests;

pub use list::Kind;
pub use settle::settle;

use crate::{WriteError, WriteFault, atomic};
use list::{Files, HIDDEN, Hidden, LIST, expanded, files_of, is_below, listed, write_list};
use settle::{check_folders, make_parent, remove, remove_folder, settle_locked};
use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// A folder that receives results. No other process can open it as one until this is dropped.
#[derive(Debug)]
pub struct ResultFolder {
    path: PathBuf,
    kind: Kind,
    files: Files,
    is_empty: bool,
    /// The folder was created here.
    is_new: bool,
    /// New results are being made that no other call goes on with.
    has_begun: bool,
    _lock: Option<File>,
}

impl Drop for ResultFolder {
    /// Leaves nothing of results that were not completed.
    fn drop(&mut self) {
        if self.has_begun {
            let _ = self.discard();
        }
        if self.is_new {
            // Only one that is empty can be removed.
            let _ = fs::remove_dir(&self.path);
        }
    }
}

impl ResultFolder {
    /// Creates or opens the folder, locks it, and ends a replacement that was interrupted.
    ///
    /// # Errors
    ///
    /// [`WriteError`]: a file has that name, another process uses the folder, or the file system refuses.
    pub fn open(path: &Path, kind: Kind) -> Result<Self, WriteError> {
        let failed = |e| WriteError::io(path, e);
        let mut is_new = false;
        match fs::metadata(path) {
            Ok(kind) if !kind.is_dir() => return Err(fault(path, WriteFault::InTheWay)),
            Ok(_) => {}
            Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
                fs::create_dir_all(path).map_err(failed)?;
                is_new = true;
            }
            Err(e) => return Err(failed(e)),
        }
        let lock = lock(path)?;
        settle_locked(path)?;
        let mut is_empty = true;
        for entry in fs::read_dir(path).map_err(failed)? {
            let name = entry.map_err(failed)?.file_name();
            is_empty &= name
                .to_str()
                .is_some_and(|name| name.starts_with(HIDDEN) || atomic::is_temporary(name));
        }
        let (path, files) = (path.to_path_buf(), files_of(path, kind));
        Ok(Self {
            path,
            kind,
            files,
            is_empty,
            is_new,
            has_begun: false,
            _lock: lock,
        })
    }

    /// The folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether nothing is in it, but for hidden files of ours and those that a killed process was
    /// writing.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.is_empty
    }

    /// Whether the list names this file.
    #[must_use]
    pub fn names(&self, file: &str) -> bool {
        self.files.contains(file)
    }

    /// Refuses files that are not ours where results would go: `names` are those of files and
    /// folders in this folder. Hidden files in such a folder do no harm.
    ///
    /// # Errors
    ///
    /// [`WriteFault::Foreign`].
    pub fn check_free<'a>(
        &self,
        names: impl IntoIterator<Item = &'a str>,
    ) -> Result<(), WriteError> {
        for name in names {
            let path = self.path.join(name.trim_end_matches('/'));
            match fs::symlink_metadata(&path) {
                Err(_) => {}
                Ok(kind) if kind.is_dir() => {
                    let foreign = listed(&path, Hidden::Passed)?.into_iter().find(|file| {
                        let file = format!("{}/{file}", name.trim_end_matches('/'));
                        !self.files.contains(&file)
                    });
                    let nested = self
                        .files
                        .contains(&format!("{}/", name.trim_end_matches('/')));
                    if let (Some(file), false) = (foreign, nested) {
                        return Err(fault(&path.join(file), WriteFault::Foreign));
                    }
                }
                Ok(_) if self.files.contains(name) => {}
                Ok(_) => return Err(fault(&path, WriteFault::Foreign)),
            }
        }
        Ok(())
    }

    /// Refuses results that would take the place of what they are made from: where one of `inputs`
    /// is, or lies in, one of the files and folders `names` of this folder, links followed.
    ///
    /// # Errors
    ///
    /// [`WriteFault::Input`].
    pub fn check_inputs<'a>(
        &self,
        names: impl IntoIterator<Item = &'a str>,
        inputs: &[&Path],
    ) -> Result<(), WriteError> {
        let places: Vec<PathBuf> = names
            .into_iter()
            .filter_map(|name| {
                self.path
                    .join(name.trim_end_matches('/'))
                    .canonicalize()
                    .ok()
            })
            .collect();
        for input in inputs {
            if let Ok(real) = input.canonicalize()
                && places.iter().any(|place| real.starts_with(place))
            {
                return Err(fault(input, WriteFault::Input));
            }
        }
        Ok(())
    }

    /// Refuses inputs that are this folder itself.
    ///
    /// # Errors
    ///
    /// [`WriteFault::Input`].
    pub fn check_not_itself(&self, inputs: &[&Path]) -> Result<(), WriteError> {
        let real = self
            .path
            .canonicalize()
            .map_err(|e| WriteError::io(&self.path, e))?;
        match inputs
            .iter()
            .find(|input| input.canonicalize().is_ok_and(|input| input == real))
        {
            Some(input) => Err(fault(input, WriteFault::Input)),
            None => Ok(()),
        }
    }

    /// Adds names to the list before the first of them is written.
    ///
    /// # Errors
    ///
    /// [`WriteFault::Foreign`] for one that is taken; else the failure of the file system.
    pub fn claim<'a>(
        &mut self,
        names: impl IntoIterator<Item = &'a str> + Clone,
    ) -> Result<(), WriteError> {
        self.check_free(names.clone())?;
        let before = self.files.len();
        self.files.extend(names.into_iter().map(str::to_owned));
        if self.files.len() == before {
            Ok(())
        } else {
            write_list(&self.path, self.kind, &self.files)
        }
    }

    /// Takes names from the list whose files were not written.
    ///
    /// # Errors
    ///
    /// The failure of the file system.
    pub fn release(&mut self) -> Result<(), WriteError> {
        let before = self.files.len();
        self.files
            .retain(|name| self.path.join(name.trim_end_matches('/')).exists());
        if self.files.len() == before {
            Ok(())
        } else {
            write_list(&self.path, self.kind, &self.files)
        }
    }

    /// The names of all files of ours that exist, those of nested folders of results included.
    #[must_use]
    pub fn existing(&self) -> Files {
        let expanded = expanded(&self.path, &self.files);
        expanded
            .into_iter()
            .filter(|name| self.path.join(name).is_file())
            .collect()
    }

    /// Removes all files of ours but those in the folder `but`, and the list.
    ///
    /// # Errors
    ///
    /// The failure of the file system.
    pub fn clear(&mut self, but: Option<&str>) -> Result<(), WriteError> {
        let (remaining, gone) = self
            .existing()
            .into_iter()
            .partition(|name| is_below(name, but));
        remove(&self.path, &gone)?;
        self.files = remaining;
        write_list(&self.path, self.kind, &self.files)
    }

    /// The folder for new results, which [`commit`](Self::commit) puts into their places.
    #[must_use]
    pub fn next(&self) -> PathBuf {
        self.kind.next(&self.path)
    }

    /// Makes the folder for new results, and removes those that were not completed. Without
    /// [`commit`](Self::commit) or [`keep`](Self::keep) they are removed in the end.
    ///
    /// # Errors
    ///
    /// The failure of the file system.
    pub fn begin(&mut self) -> Result<PathBuf, WriteError> {
        self.discard()?;
        let next = self.next();
        fs::create_dir(&next).map_err(|e| WriteError::io(&next, e))?;
        self.has_begun = true;
        Ok(next)
    }

    /// Keeps new results that are not completed, so that another call goes on with them.
    pub fn keep(&mut self) {
        self.has_begun = false;
    }

    /// The same, with all files that are ours, which share their bytes with the old ones where the
    /// file system can: a file may be replaced, never changed.
    ///
    /// # Errors
    ///
    /// The failure of the file system.
    pub fn begin_with_old(&mut self) -> Result<PathBuf, WriteError> {
        let next = self.begin()?;
        for name in self.existing() {
            let (from, to) = (self.path.join(&name), next.join(&name));
            make_parent(&to)?;
            fs::hard_link(&from, &to)
                .or_else(|_| fs::copy(&from, &to).map(|_| ()))
                .map_err(|e| WriteError::io(&to, e))?;
        }
        Ok(next)
    }

    /// Removes new results that are not complete.
    ///
    /// # Errors
    ///
    /// The failure of the file system.
    pub fn discard(&self) -> Result<(), WriteError> {
        remove_folder(&self.next())
    }

    /// Puts the new results into their places, and removes old ones that have no successor but
    /// those in the folder `but`. Interrupted at any time, the old or the new ones are whole once
    /// the folder is opened again. Returns the bytes of the new results.
    ///
    /// # Errors
    ///
    /// [`WriteFault::Foreign`] where a file that is not ours has the name of a result, which is
    /// then not put into its place; else the failure of the file system.
    pub fn commit(&mut self, but: Option<&str>) -> Result<u64, WriteError> {
        let (next, done) = (self.next(), self.kind.done(&self.path));
        let mut new: Files = listed(&next, Hidden::Ours)?.into_iter().collect();
        new.remove(LIST);
        let old = expanded(&self.path, &self.files);
        for name in &new {
            let place = self.path.join(name);
            if !old.contains(name) && fs::symlink_metadata(&place).is_ok() {
                return Err(fault(&place, WriteFault::Foreign));
            }
            check_folders(&self.path, name)?;
        }
        let mut bytes = 0;
        for name in &new {
            let path = next.join(name);
            bytes += fs::metadata(&path)
                .map_err(|e| WriteError::io(&path, e))?
                .len();
        }
        new.extend(old.into_iter().filter(|name| is_below(name, but)));
        write_list(&next, self.kind, &new)?;
        fs::rename(&next, &done).map_err(|e| WriteError::io(&self.path, e))?;
        settle_locked(&self.path)?;
        self.files = files_of(&self.path, self.kind);
        (self.is_empty, self.has_begun) = (false, false);
        Ok(bytes)
    }
}

/// Locks the folder itself, so that no lock file is left behind; `None` on systems that cannot lock
/// a folder.
fn lock(folder: &Path) -> Result<Option<File>, WriteError> {
    let Ok(handle) = File::open(folder) else {
        return Ok(None);
    };
    match handle.try_lock() {
        Err(TryLockError::WouldBlock) => Err(fault(folder, WriteFault::Busy)),
        _ => Ok(Some(handle)),
    }
}

fn fault(path: &Path, fault: WriteFault) -> WriteError {
    WriteError {
        path: path.to_path_buf(),
        fault,
    }
}

/// Refuses a file as the place of a result that is made from it, links followed.
///
/// # Errors
///
/// [`WriteFault::Input`].
pub fn check_target(target: &Path, inputs: &[&Path]) -> Result<(), WriteError> {
    atomic::check(target).map_err(|e: io::Error| WriteError::io(target, e))?;
    let real = target.canonicalize();
    let same = |input: &&Path| {
        real.as_ref()
            .is_ok_and(|real| input.canonicalize().is_ok_and(|input| input == *real))
    };
    match inputs.iter().find(|input| same(input)) {
        Some(input) => Err(fault(input, WriteFault::Input)),
        None => Ok(()),
    }
}
