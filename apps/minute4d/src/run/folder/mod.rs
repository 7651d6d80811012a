//! The folders of a run and of a capture: the names of their files, which of them may be replaced,
//! and the stage that writes a capture.
//!
//! [`m4_io::results`] says which files are ours. New results are made beside finished ones, which
//! are whole until the new ones are: `run` for runs, `capture` for captures.

mod capture;
mod run;

pub(crate) use capture::CaptureFolder;
pub(crate) use run::RunFolder;

use m4_io::atomic;
use m4_io::results::ResultFolder;
use minute4d::Error;
use minute4d::OutputError;
use minute4d::layout::{CHECKPOINT_FOLDER, Existing, remove_file};
use std::fs;
use std::path::{Path, PathBuf};

/// Removes the temporary files of these names that a killed process left ([`m4_io::atomic`]).
fn remove_half_written(folder: &Path, names: &[&str]) -> Result<(), Error> {
    let is_ours = |name: &str| names.iter().any(|own| atomic::is_temporary_of(name, own));
    atomic::remove_temporary(folder, false, &is_ours).map_err(Error::write(folder))
}

/// The record of an earlier run or capture to resume; `None` to replace it. One with `nothing`
/// worth keeping is replaced. What the folder contains and the file that is `missing` without a
/// record are for the messages.
fn take_over<R>(
    results: &ResultFolder,
    existing: Existing,
    record: Option<R>,
    nothing: bool,
    what: impl FnOnce() -> String,
    missing: &'static str,
) -> Result<Option<R>, Error> {
    let path = results.path().to_path_buf();
    match (record, existing) {
        _ if results.is_empty() => Ok(None),
        (Some(record), Existing::Resume) => Ok(Some(record)),
        (_, Existing::Force) => Ok(None),
        (Some(_), Existing::Refuse) if nothing => Ok(None),
        (Some(_), Existing::Refuse) => Err(OutputError::Exists { path, what: what() }.into()),
        (None, _) => Err(OutputError::NotOurs { path, missing }.into()),
    }
}

/// Returns the file of the checkpoint after this many iterations.
pub(crate) fn checkpoint_file(folder: &Path, iteration: usize) -> PathBuf {
    folder
        .join(CHECKPOINT_FOLDER)
        .join(format!("{iteration:07}.safetensors"))
}

/// Returns the checkpoints of a run and their iterations, oldest first.
pub(crate) fn checkpoints(folder: &Path) -> Vec<(usize, PathBuf)> {
    let Ok(entries) = fs::read_dir(folder.join(CHECKPOINT_FOLDER)) else {
        return Vec::new();
    };
    let mut checkpoints: Vec<(usize, PathBuf)> = entries
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            let iteration = path
                .file_name()?
                .to_str()?
                .strip_suffix(".safetensors")?
                .parse()
                .ok()?;
            Some((iteration, path))
        })
        .collect();
    checkpoints.sort();
    checkpoints
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
