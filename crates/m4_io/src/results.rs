//! Folders of results: which of their files are ours, and how new results take the place of old ones.
//!
//! ```text
//! .minute4d-files.json     for each kind of results the files that were written here, and the names that a command at work may use
//! .minute4d-KIND-next/     new results while they are made; a killed process leaves it, and what was there before is whole
//! .minute4d-KIND-done/     complete new results that take their places: whoever opens the folder next ends that
//! ```
//!
//! Only files that the list names for the same kind are ever removed or replaced. A folder without a list has none of ours.

use crate::{WriteError, WriteFault, atomic};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Component, Path, PathBuf};

/// The list of our files.
const LIST: &str = ".minute4d-files.json";
/// How names of our own hidden files start.
const HIDDEN: &str = ".minute4d-";
/// How the name of a folder with complete new results ends.
const DONE: &str = "-done";

/// The kind of results; a folder may contain several.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Kind {
    /// A trained scene with what belongs to it.
    Run,
    /// A capture.
    Capture,
    /// Rendered images.
    Render,
    /// A PLY file per frame.
    PlySequence,
    /// A COLMAP model.
    Colmap,
    /// Reports over several runs.
    Report,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Run => "run",
            Self::Capture => "capture",
            Self::Render => "render",
            Self::PlySequence => "ply-sequence",
            Self::Colmap => "colmap",
            Self::Report => "report",
        }
    }

    fn of_name(name: &str) -> Option<Self> {
        let all = [Self::Run, Self::Capture, Self::Render, Self::PlySequence, Self::Colmap, Self::Report];
        all.into_iter().find(|kind| kind.name() == name)
    }

    fn next(self, folder: &Path) -> PathBuf {
        folder.join(format!("{HIDDEN}{}-next", self.name()))
    }

    fn done(self, folder: &Path) -> PathBuf {
        folder.join(format!("{HIDDEN}{}{DONE}", self.name()))
    }
}

/// Relative names, with `/`. One that ends in `/` is a folder of results with a list of its own.
type Files = BTreeSet<String>;

#[derive(Serialize, Deserialize)]
struct List {
    format: String,
    files: BTreeMap<Kind, Files>,
}

/// A folder that receives results. No other process can open it as one until this is dropped.
#[derive(Debug)]
pub struct ResultFolder {
    path: PathBuf,
    kind: Kind,
    files: Files,
    is_empty: bool,
    _lock: Option<File>,
}

impl ResultFolder {
    /// Creates or opens the folder, locks it, and ends a replacement that was interrupted.
    ///
    /// # Errors
    ///
    /// [`WriteError`]: a file has that name, another process uses the folder, or the file system refuses.
    pub fn open(path: &Path, kind: Kind) -> Result<Self, WriteError> {
        let failed = |e| WriteError::io(path, e);
        match fs::metadata(path) {
            Ok(kind) if !kind.is_dir() => return Err(fault(path, WriteFault::InTheWay)),
            Ok(_) => {}
            Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
                fs::create_dir_all(path).map_err(failed)?;
            }
            Err(e) => return Err(failed(e)),
        }
        let lock = lock(path)?;
        settle_locked(path)?;
        let mut is_empty = true;
        for entry in fs::read_dir(path).map_err(failed)? {
            let name = entry.map_err(failed)?.file_name();
            is_empty &= name.to_str().is_some_and(|name| name.starts_with(HIDDEN) || atomic::is_temporary(name));
        }
        Ok(Self { path: path.to_path_buf(), kind, files: files(path, kind), is_empty, _lock: lock })
    }

    /// The folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether nothing is in it, but for hidden files of ours and those that a killed process was writing.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.is_empty
    }

    /// Whether the list names this file.
    #[must_use]
    pub fn names(&self, file: &str) -> bool {
        self.files.contains(file)
    }

    /// Refuses files that are not ours where results would go: `names` are those of files and folders in this folder. Hidden files in
    /// such a folder do no harm.
    ///
    /// # Errors
    ///
    /// [`WriteFault::Foreign`].
    pub fn check_free<'a>(&self, names: impl IntoIterator<Item = &'a str>) -> Result<(), WriteError> {
        for name in names {
            let path = self.path.join(name.trim_end_matches('/'));
            match fs::symlink_metadata(&path) {
                Err(_) => {}
                Ok(kind) if kind.is_dir() => {
                    let foreign = listed(&path, Hidden::Passed)?.into_iter().find(|file| {
                        let file = format!("{}/{file}", name.trim_end_matches('/'));
                        !self.files.contains(&file)
                    });
                    let nested = self.files.contains(&format!("{}/", name.trim_end_matches('/')));
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

    /// Refuses results that would take the place of what they are made from: where one of `inputs` is, or lies in, one of the files and
    /// folders `names` of this folder, links followed.
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
            .filter_map(|name| self.path.join(name.trim_end_matches('/')).canonicalize().ok())
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
        let real = self.path.canonicalize().map_err(|e| WriteError::io(&self.path, e))?;
        match inputs.iter().find(|input| input.canonicalize().is_ok_and(|input| input == real)) {
            Some(input) => Err(fault(input, WriteFault::Input)),
            None => Ok(()),
        }
    }

    /// Adds names to the list before the first of them is written.
    ///
    /// # Errors
    ///
    /// [`WriteFault::Foreign`] for one that is taken; else the failure of the file system.
    pub fn claim<'a>(&mut self, names: impl IntoIterator<Item = &'a str> + Clone) -> Result<(), WriteError> {
        self.check_free(names.clone())?;
        let before = self.files.len();
        self.files.extend(names.into_iter().map(str::to_owned));
        if self.files.len() == before { Ok(()) } else { write_list(&self.path, self.kind, &self.files) }
    }

    /// Takes names from the list whose files were not written.
    ///
    /// # Errors
    ///
    /// The failure of the file system.
    pub fn release(&mut self) -> Result<(), WriteError> {
        let before = self.files.len();
        self.files.retain(|name| self.path.join(name.trim_end_matches('/')).exists());
        if self.files.len() == before { Ok(()) } else { write_list(&self.path, self.kind, &self.files) }
    }

    /// The names of all files of ours that exist, those of nested folders of results included.
    #[must_use]
    pub fn existing(&self) -> Files {
        let expanded = expanded(&self.path, &self.files);
        expanded.into_iter().filter(|name| self.path.join(name).is_file()).collect()
    }

    /// Removes all files of ours but those in the folder `but`, and the list.
    ///
    /// # Errors
    ///
    /// The failure of the file system.
    pub fn clear(&mut self, but: Option<&str>) -> Result<(), WriteError> {
        let (kept, gone) = self.existing().into_iter().partition(|name| is_below(name, but));
        remove(&self.path, &gone)?;
        self.files = kept;
        write_list(&self.path, self.kind, &self.files)
    }

    /// The folder for new results, which [`commit`](Self::commit) puts into their places.
    #[must_use]
    pub fn next(&self) -> PathBuf {
        self.kind.next(&self.path)
    }

    /// Makes the folder for new results, and removes those that were not completed.
    ///
    /// # Errors
    ///
    /// The failure of the file system.
    pub fn begin(&self) -> Result<PathBuf, WriteError> {
        self.discard()?;
        let next = self.next();
        fs::create_dir(&next).map_err(|e| WriteError::io(&next, e))?;
        Ok(next)
    }

    /// The same, with all files that are ours, which share their bytes with the old ones where the file system can: a file may be
    /// replaced, never changed.
    ///
    /// # Errors
    ///
    /// The failure of the file system.
    pub fn begin_with_old(&self) -> Result<PathBuf, WriteError> {
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

    /// Puts the new results into their places, and removes old ones that have no successor but those in the folder `but`. Interrupted
    /// at any time, the old or the new ones are whole once the folder is opened again. Returns the bytes of the new results.
    ///
    /// # Errors
    ///
    /// [`WriteFault::Foreign`] where a file that is not ours has the name of a result, which is then not put into its place; else the
    /// failure of the file system.
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
            bytes += fs::metadata(&path).map_err(|e| WriteError::io(&path, e))?.len();
        }
        new.extend(old.into_iter().filter(|name| is_below(name, but)));
        write_list(&next, self.kind, &new)?;
        fs::rename(&next, &done).map_err(|e| WriteError::io(&self.path, e))?;
        settle_locked(&self.path)?;
        self.files = files(&self.path, self.kind);
        self.is_empty = false;
        Ok(bytes)
    }
}

/// Ends a replacement that was interrupted after the new results were complete; for who reads a folder of results.
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

/// The kinds of results in a folder that are complete and not in their places; none where it cannot be read, which its reader reports.
fn complete(folder: &Path) -> Vec<Kind> {
    let names = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.file_name());
    let kind = |name: std::ffi::OsString| Kind::of_name(name.to_str()?.strip_prefix(HIDDEN)?.strip_suffix(DONE)?);
    names.filter_map(kind).collect()
}

fn settle_locked(folder: &Path) -> Result<(), WriteError> {
    for kind in complete(folder) {
        let done = kind.done(folder);
        let (new, old) = (files(&done, kind), files(folder, kind));
        // Until the end, the old and the new ones are ours.
        let old = expanded(folder, &old);
        write_list(folder, kind, &old.union(&new).cloned().collect())?;
        for name in listed(&done, Hidden::Ours)?.into_iter().filter(|name| name != LIST) {
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

/// Locks the folder itself, so that no lock file is left behind; `None` on systems that cannot lock a folder.
fn lock(folder: &Path) -> Result<Option<File>, WriteError> {
    let Ok(handle) = File::open(folder) else { return Ok(None) };
    match handle.try_lock() {
        Err(TryLockError::WouldBlock) => Err(fault(folder, WriteFault::Busy)),
        _ => Ok(Some(handle)),
    }
}

fn fault(path: &Path, fault: WriteFault) -> WriteError {
    WriteError { path: path.to_path_buf(), fault }
}

/// The list of a folder; empty where it is missing or damaged. Names that lead out of the folder are no names of ours.
fn list(folder: &Path) -> BTreeMap<Kind, Files> {
    let list: Option<List> = fs::read(folder.join(LIST)).ok().and_then(|text| serde_json::from_slice(&text).ok());
    let mut kinds = list.map(|list| list.files).unwrap_or_default();
    let inside = |name: &String| Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
    kinds.values_mut().for_each(|files| files.retain(inside));
    kinds
}

fn files(folder: &Path, kind: Kind) -> Files {
    list(folder).remove(&kind).unwrap_or_default()
}

fn write_list(folder: &Path, kind: Kind, files: &Files) -> Result<(), WriteError> {
    let path = folder.join(LIST);
    let mut kinds = list(folder);
    kinds.insert(kind, files.clone());
    let list = List { format: "minute4d-files".to_owned(), files: kinds };
    let text = serde_json::to_vec_pretty(&list).map_err(|e| WriteError::io(&path, e.into()))?;
    atomic::write(&path, &text).map_err(|e| WriteError::io(&path, e))
}

/// The names with those of nested folders of results and their lists.
fn expanded(folder: &Path, files: &Files) -> Files {
    let mut all = Files::new();
    for name in files {
        let Some(nested) = name.strip_suffix('/') else {
            all.insert(name.clone());
            continue;
        };
        let kinds = list(&folder.join(nested));
        if !kinds.is_empty() {
            all.insert(format!("{nested}/{LIST}"));
        }
        for own in kinds.values() {
            all.extend(expanded(&folder.join(nested), own).into_iter().map(|file| format!("{nested}/{file}")));
        }
    }
    all
}

/// The names, with those of a nested folder of results as one.
fn with_nested(mut names: Files) -> Files {
    let ending = format!("/{LIST}");
    let nested: Vec<String> = names.iter().filter_map(|name| name.strip_suffix(&ending)).map(str::to_owned).collect();
    for folder in nested {
        names.retain(|name| !is_below(name, Some(&folder)));
        names.insert(folder + "/");
    }
    names
}

fn is_below(name: &str, folder: Option<&str>) -> bool {
    folder.is_some_and(|folder| name.strip_prefix(folder).is_some_and(|rest| rest.starts_with('/')))
}

/// Which hidden files count.
#[derive(Clone, Copy, PartialEq)]
enum Hidden {
    Passed,
    /// Lists of nested folders.
    Ours,
}

/// The files below a folder, relative, with `/`; links are files.
fn listed(folder: &Path, hidden: Hidden) -> Result<Vec<String>, WriteError> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(|e| WriteError::io(folder, e))? {
        let entry = entry.map_err(|e| WriteError::io(folder, e))?;
        let kind = entry.file_type().map_err(|e| WriteError::io(&entry.path(), e))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with('.') && (hidden == Hidden::Passed || name != LIST) {
            continue;
        }
        if kind.is_dir() {
            names.extend(listed(&entry.path(), hidden)?.into_iter().map(|file| format!("{name}/{file}")));
        } else {
            names.push(name);
        }
    }
    names.sort();
    Ok(names)
}

/// Refuses a name whose folders are links: the files would lie elsewhere.
fn check_folders(folder: &Path, name: &str) -> Result<(), WriteError> {
    let mut path = folder.to_path_buf();
    for part in Path::new(name).parent().into_iter().flat_map(Path::components) {
        path.push(part);
        if fs::symlink_metadata(&path).is_ok_and(|kind| !kind.is_dir()) {
            return Err(fault(&path, WriteFault::Foreign));
        }
    }
    Ok(())
}

fn make_parent(path: &Path) -> Result<(), WriteError> {
    path.parent().map_or(Ok(()), |parent| fs::create_dir_all(parent).map_err(|e| WriteError::io(parent, e)))
}

/// Removes files of ours, and the folders that become empty by that.
fn remove(folder: &Path, names: &Files) -> Result<(), WriteError> {
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

fn remove_folder(path: &Path) -> Result<(), WriteError> {
    match fs::remove_dir_all(path) {
        Err(e) if e.kind() != ErrorKind::NotFound => Err(WriteError::io(path, e)),
        _ => Ok(()),
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
    let same = |input: &&Path| real.as_ref().is_ok_and(|real| input.canonicalize().is_ok_and(|input| input == *real));
    match inputs.iter().find(|input| same(input)) {
        Some(input) => Err(fault(input, WriteFault::Input)),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::{Kind, ResultFolder, check_target, files, settle};
    use crate::{ErrorKind, WriteFault};
    use std::collections::BTreeSet;
    use std::fs;
    use std::path::{Path, PathBuf};

    fn write(folder: &Path, name: &str, text: &str) {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    /// The files in a folder that are not hidden, with their texts.
    fn state(folder: &Path) -> Vec<(String, String)> {
        let mut all = Vec::new();
        let mut open = vec![PathBuf::new()];
        while let Some(at) = open.pop() {
            for entry in fs::read_dir(folder.join(&at)).unwrap() {
                let entry = entry.unwrap();
                let name = at.join(entry.file_name());
                if entry.file_name().to_string_lossy().starts_with('.') {
                    continue;
                }
                if entry.file_type().unwrap().is_dir() {
                    open.push(name);
                } else {
                    all.push((name.to_string_lossy().into_owned(), fs::read_to_string(entry.path()).unwrap()));
                }
            }
        }
        all.sort();
        all
    }

    fn commit(folder: &Path, new: &[(&str, &str)]) {
        let mut results = ResultFolder::open(folder, Kind::Capture).unwrap();
        let next = results.begin().unwrap();
        new.iter().for_each(|(name, text)| write(&next, name, text));
        results.commit(None).unwrap();
    }

    fn owned(list: &[(&str, &str)]) -> Vec<(String, String)> {
        list.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect()
    }

    const OLD: [(&str, &str); 3] = [("depth/0", "old"), ("list", "old"), ("train/0", "old")];
    const NEW: [(&str, &str); 3] = [("list", "new"), ("train/0", "new"), ("train/1", "new")];

    #[test]
    fn commit_replaces_our_files_and_no_others() {
        let dir = tempfile::tempdir().unwrap();
        write(dir.path(), "depth/thesis.txt", "mine");
        commit(dir.path(), &OLD);
        write(dir.path(), "train/notes.txt", "mine");
        let all = [&OLD[..1], &[("depth/thesis.txt", "mine")], &OLD[1..], &[("train/notes.txt", "mine")]].concat();
        assert_eq!(state(dir.path()), owned(&all));
        commit(dir.path(), &NEW);
        let all = [&[("depth/thesis.txt", "mine")], &NEW[..], &[("train/notes.txt", "mine")]].concat();
        assert_eq!(state(dir.path()), owned(&all));
        // Other kinds of results are not touched, nor may they be replaced.
        let mut other = ResultFolder::open(dir.path(), Kind::Render).unwrap();
        let next = other.begin().unwrap();
        write(&next, "0.png", "image");
        other.commit(None).unwrap();
        assert_eq!(state(dir.path()).len(), 6);
        write(&other.begin().unwrap(), "list", "image");
        assert!(matches!(other.commit(None).unwrap_err().fault, WriteFault::Foreign));
        drop(other);
        commit(dir.path(), &NEW);
        assert_eq!(state(dir.path()).len(), 6);
    }

    #[test]
    fn foreign_files_are_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        write(dir.path(), "train/7", "mine");
        write(dir.path(), "list", "mine");
        let mut results = ResultFolder::open(dir.path(), Kind::Capture).unwrap();
        assert!(!results.is_empty());
        for (name, file) in [("train", "train/7"), ("list", "list")] {
            let error = results.check_free([name]).unwrap_err();
            assert!(error.kind() == ErrorKind::CannotWrite && error.path.ends_with(file), "{error}");
            assert!(results.claim([name]).is_err());
        }
        results.check_free(["depth"]).unwrap();
        write(&results.begin().unwrap(), "train/7", "new");
        assert!(results.commit(None).unwrap_err().path.ends_with("train/7"));
        assert_eq!(fs::read(dir.path().join("train/7")).unwrap(), b"mine");
    }

    #[test]
    fn replacements_that_were_interrupted_anywhere_are_completed() {
        let dir = tempfile::tempdir().unwrap();
        // As many steps of the last part as were done, with or without the list of old and new files.
        for moved in 0..=NEW.len() {
            for listed in [false, true] {
                let folder = dir.path().join(format!("{moved}-{listed}"));
                commit(&folder, &OLD);
                let results = ResultFolder::open(&folder, Kind::Capture).unwrap();
                let next = results.begin().unwrap();
                NEW.iter().for_each(|(name, text)| write(&next, name, text));
                drop(results);
                // Until here the old results are whole, and opening the folder changes nothing.
                settle(&folder).unwrap();
                assert_eq!(state(&folder), owned(&OLD));
                let names: BTreeSet<String> = NEW.iter().map(|(name, _)| (*name).to_owned()).collect();
                super::write_list(&next, Kind::Capture, &names).unwrap();
                let done = Kind::Capture.done(&folder);
                fs::rename(&next, &done).unwrap();
                if moved > 0 || listed {
                    let both = files(&folder, Kind::Capture).union(&names).cloned().collect();
                    super::write_list(&folder, Kind::Capture, &both).unwrap();
                }
                for (name, _) in &NEW[..moved] {
                    fs::create_dir_all(folder.join(name).parent().unwrap()).unwrap();
                    fs::rename(done.join(name), folder.join(name)).unwrap();
                }
                settle(&folder).unwrap();
                assert_eq!(state(&folder), owned(&NEW), "{moved} {listed}");
                assert_eq!(files(&folder, Kind::Capture), names);
                assert!(!done.exists() && !folder.join("depth").exists());
            }
        }
    }

    #[test]
    fn nested_results_go_and_stay_with_the_folder() {
        let dir = tempfile::tempdir().unwrap();
        let mut run = ResultFolder::open(dir.path(), Kind::Run).unwrap();
        run.claim(["scene", "capture/"]).unwrap();
        write(dir.path(), "scene", "old");
        commit(&dir.path().join("capture"), &OLD);
        write(dir.path(), "capture/mine", "mine");
        run.check_free(["scene", "capture/"]).unwrap();
        // The old files are the first new ones, until others replace them.
        let next = run.begin_with_old().unwrap();
        assert_eq!(fs::read(next.join("capture/train/0")).unwrap(), b"old");
        commit(&next.join("capture"), &NEW);
        assert_eq!(fs::read(dir.path().join("capture/train/0")).unwrap(), b"old");
        run.commit(None).unwrap();
        assert_eq!(fs::read(dir.path().join("capture/train/1")).unwrap(), b"new");
        assert!(!dir.path().join("capture/depth").exists() && run.names("capture/"));
        // The folder of an input keeps its files.
        write(&run.begin().unwrap(), "scene", "new");
        run.commit(Some("capture")).unwrap();
        assert_eq!(state(dir.path()).len(), 5);
        write(&run.begin().unwrap(), "scene", "newer");
        run.commit(None).unwrap();
        assert_eq!(state(dir.path()), owned(&[("capture/mine", "mine"), ("scene", "newer")]));
    }

    #[cfg(unix)]
    #[test]
    fn inputs_and_links_are_not_replaced() {
        use std::os::unix::fs::symlink;
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        write(dir.path(), "images/0", "mine");
        commit(&at("cap"), &OLD);
        let results = ResultFolder::open(&at("cap"), Kind::Capture).unwrap();
        symlink(at("cap"), at("alias")).unwrap();
        for input in ["cap/train", "cap/train/0", "alias/train", "cap/../cap/list"] {
            let error = results.check_inputs(["train", "list"], &[&at(input)]).unwrap_err();
            assert!(matches!(error.fault, WriteFault::Input), "{input}");
        }
        assert!(results.check_not_itself(&[&at("alias")]).is_err());
        results.check_inputs(["train", "list"], &[&at("images"), &at("cap/depth")]).unwrap();
        drop(results);
        // A folder of ours that became a link: nothing behind it is touched.
        fs::rename(at("cap/depth"), at("elsewhere")).unwrap();
        symlink(at("elsewhere"), at("cap/depth")).unwrap();
        commit(&at("cap"), &NEW);
        assert_eq!(fs::read(at("elsewhere/0")).unwrap(), b"old");
        let mut results = ResultFolder::open(&at("cap"), Kind::Capture).unwrap();
        write(&results.begin().unwrap(), "depth/0", "new");
        assert!(results.commit(None).is_err());
        assert_eq!(fs::read(at("elsewhere/0")).unwrap(), b"old");

        symlink(at("images/0"), at("image")).unwrap();
        assert!(check_target(&at("image"), &[&at("images/0")]).is_err());
        symlink("/dev/null", at("device")).unwrap();
        symlink("nothing", at("dangling")).unwrap();
        for target in [Path::new("/dev/full"), &at("device"), &at("images"), &at("dangling")] {
            assert!(check_target(target, &[]).is_err(), "{}", target.display());
        }
        // A link to a file is followed: the file gets the new contents.
        crate::atomic::write(&at("image"), b"new").unwrap();
        assert!(fs::symlink_metadata(at("image")).unwrap().is_symlink());
        assert_eq!(fs::read(at("images/0")).unwrap(), b"new");
    }

    #[test]
    fn lists_that_name_files_elsewhere_are_not_followed() {
        let dir = tempfile::tempdir().unwrap();
        write(dir.path(), "private", "mine");
        let text = r#"{"format": "minute4d-files", "files": {"capture": ["../private", "/etc/passwd", "a"]}}"#;
        write(&dir.path().join("cap"), super::LIST, text);
        assert_eq!(files(&dir.path().join("cap"), Kind::Capture), BTreeSet::from(["a".to_owned()]));
        commit(&dir.path().join("cap"), &NEW);
        assert_eq!(fs::read(dir.path().join("private")).unwrap(), b"mine");
    }

    #[test]
    fn only_one_process_has_a_folder() {
        let dir = tempfile::tempdir().unwrap();
        let _first = ResultFolder::open(dir.path(), Kind::Run).unwrap();
        let error = ResultFolder::open(dir.path(), Kind::Run).unwrap_err();
        assert!(cfg!(windows) || error.kind() == ErrorKind::Busy);
    }
}
