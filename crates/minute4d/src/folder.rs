//! The folder of a run: the names of its files, and which of them may be replaced.

use crate::error::OutputError;
use crate::record::{GEOMETRY_FILE, RUN_FILE, RunRecord, Status};
use crate::{Error, capture_folder};
use std::fs::{self, File, TryLockError};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// The trained scene.
pub const SCENE_FILE: &str = "scene.safetensors";
/// The metrics of training, one JSON object per line.
pub const METRICS_FILE: &str = "metrics.jsonl";
/// Source, re-render and frozen time side by side.
pub const PREVIEW_FILE: &str = "preview.mp4";
/// The page that shows the scene in a browser.
pub const VIEWER_FILE: &str = "viewer.html";
/// Scores over the held-out views.
pub const EVAL_FILE: &str = "eval.json";
/// The capture that `run` makes of a video.
pub const CAPTURE_FOLDER: &str = "capture";
/// Scenes saved during training.
pub const CHECKPOINT_FOLDER: &str = "checkpoints";

/// What to do with a folder that is not empty.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Existing {
    /// Leave the folder unchanged and fail.
    #[default]
    Refuse,
    /// Resume an earlier run.
    Resume,
    /// Replace the results of an earlier run; other files are kept.
    Force,
}

/// Creates or reuses the folder of a run, and locks it. With [`Existing::Resume`] returns the earlier record.
///
/// # Errors
///
/// [`OutputError::InTheWay`] for a file of that name, [`OutputError::NotOurs`] for a folder with other things in
/// it, [`OutputError::Exists`] for an unexpected earlier run, [`OutputError::Busy`] for one that is running,
/// [`Error::Write`] if the folder cannot be written.
pub(crate) fn open(folder: &Path, existing: Existing) -> Result<(Lock, Option<RunRecord>), Error> {
    let filled = make(folder)?;
    let lock = Lock::take(folder)?;
    let earlier = if filled { take_over(folder, existing)? } else { None };
    // No other process writes these while the folder is locked.
    for path in half_written(folder, &OWN_FILES)?.into_iter().chain(half_written_checkpoints(folder)?) {
        remove_file(&path)?;
    }
    Ok((lock, earlier))
}

/// The files that a run writes into its folder, its record first.
const OWN_FILES: [&str; 5] = [RUN_FILE, SCENE_FILE, METRICS_FILE, PREVIEW_FILE, VIEWER_FILE];

/// The temporary files of these names that a killed process left ([`m4_io::atomic`]).
pub(crate) fn half_written(folder: &Path, names: &[&str]) -> Result<Vec<PathBuf>, Error> {
    let found = hidden(folder)?;
    let ours = |name: &str| names.iter().any(|own| m4_io::atomic::is_temporary_of(name, own));
    Ok(found.into_iter().filter(|(name, _)| ours(name)).map(|(_, path)| path).collect())
}

fn half_written_checkpoints(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let found = hidden(&folder.join(CHECKPOINT_FOLDER))?;
    Ok(found.into_iter().map(|(_, path)| path).collect())
}

/// Returns the hidden files of a folder; empty if the folder is missing.
fn hidden(folder: &Path) -> Result<Vec<(String, PathBuf)>, Error> {
    let failed = |source| Error::Read { path: folder.to_path_buf(), source };
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(failed)?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let entry = entry.map_err(failed)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with('.') && entry.file_type().map_err(failed)?.is_file() {
            found.push((name, entry.path()));
        }
    }
    Ok(found)
}

fn take_over(folder: &Path, existing: Existing) -> Result<Option<RunRecord>, Error> {
    let record = RunRecord::read(folder)?;
    match (record, existing) {
        (Some(record), Existing::Resume) => Ok(Some(record)),
        // A failed attempt left nothing worth keeping.
        (Some(record), Existing::Refuse) if record.status == Status::Failed && !has_results(folder) => {
            clear(folder)?;
            Ok(None)
        }
        (Some(record), Existing::Refuse) => Err(OutputError::Exists {
            path: folder.to_path_buf(),
            what: match record.status {
                Status::Finished => "a finished run",
                _ => "an unfinished run",
            },
        }
        .into()),
        (_, Existing::Force) => {
            clear(folder)?;
            Ok(None)
        }
        (None, _) => Err(OutputError::NotOurs { path: folder.to_path_buf(), missing: RUN_FILE }.into()),
    }
}

fn has_results(folder: &Path) -> bool {
    folder.join(SCENE_FILE).exists() || folder.join(CAPTURE_FOLDER).exists() || !checkpoints(folder).is_empty()
}

/// Keeps other processes out of a folder for as long as it lives.
#[derive(Debug)]
pub(crate) struct Lock {
    _folder: Option<File>,
}

impl Lock {
    /// Locks the folder itself, so that no lock file is left behind. Systems that cannot lock a folder
    /// run without a lock.
    pub fn take(folder: &Path) -> Result<Self, Error> {
        let Ok(handle) = File::open(folder) else {
            return Ok(Self { _folder: None });
        };
        match handle.try_lock() {
            Err(TryLockError::WouldBlock) => Err(OutputError::Busy { path: folder.to_path_buf() }.into()),
            _ => Ok(Self { _folder: Some(handle) }),
        }
    }
}

/// Creates the folder if it is missing; returns true if it is not empty, ignoring a half-written first record.
pub(crate) fn make(folder: &Path) -> Result<bool, Error> {
    let write = |source| Error::Write { path: folder.to_path_buf(), source };
    match fs::metadata(folder) {
        Ok(kind) if !kind.is_dir() => Err(OutputError::InTheWay { path: folder.to_path_buf() }.into()),
        Ok(_) => {
            let torn = half_written(folder, &[RUN_FILE, GEOMETRY_FILE])?;
            Ok(fs::read_dir(folder).map_err(write)?.count() > torn.len())
        }
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            fs::create_dir_all(folder).map_err(write)?;
            Ok(false)
        }
        Err(error) => Err(write(error)),
    }
}

/// Removes the files of a run, and nothing else. The record stays until a new one replaces it.
fn clear(folder: &Path) -> Result<(), Error> {
    for file in [SCENE_FILE, METRICS_FILE, PREVIEW_FILE, VIEWER_FILE, EVAL_FILE] {
        remove_file(&folder.join(file))?;
    }
    remove_checkpoints(folder)?;
    let capture = folder.join(CAPTURE_FOLDER);
    if capture.is_dir() {
        capture_folder::clear(&capture)?;
    }
    Ok(())
}

/// Removes a file that may be missing.
pub(crate) fn remove_file(path: &Path) -> Result<(), Error> {
    match fs::remove_file(path) {
        Err(source) if source.kind() != ErrorKind::NotFound => Err(Error::Write { path: path.to_path_buf(), source }),
        _ => Ok(()),
    }
}

/// Removes a folder with what is in it, which may be missing.
pub(crate) fn remove_folder(path: &Path) -> Result<(), Error> {
    match fs::remove_dir_all(path) {
        Err(source) if source.kind() != ErrorKind::NotFound => Err(Error::Write { path: path.to_path_buf(), source }),
        _ => Ok(()),
    }
}

/// Returns the file of the checkpoint after this many iterations.
pub(crate) fn checkpoint_file(folder: &Path, iteration: usize) -> PathBuf {
    folder.join(CHECKPOINT_FOLDER).join(format!("{iteration:07}.safetensors"))
}

/// Returns the checkpoints of a run and their iterations, oldest first.
pub(crate) fn checkpoints(folder: &Path) -> Vec<(usize, PathBuf)> {
    let Ok(entries) = fs::read_dir(folder.join(CHECKPOINT_FOLDER)) else {
        return Vec::new();
    };
    let mut found: Vec<(usize, PathBuf)> = entries
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            let iteration = path.file_name()?.to_str()?.strip_suffix(".safetensors")?.parse().ok()?;
            Some((iteration, path))
        })
        .collect();
    found.sort();
    found
}

/// Removes every checkpoint, and their folder if nothing else is in it.
pub(crate) fn remove_checkpoints(folder: &Path) -> Result<(), Error> {
    for (_, path) in checkpoints(folder) {
        remove_file(&path)?;
    }
    // A folder with something else in it stays.
    let _ = fs::remove_dir(folder.join(CHECKPOINT_FOLDER));
    Ok(())
}
