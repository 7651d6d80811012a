//! The folders of a run and of a capture: the names of their files, which of them may be replaced, and the stage that writes a capture.

use crate::enhance::REPORT_FILE;
use crate::error::OutputError;
use crate::record::{GEOMETRY_FILE, GeometryRecord, RUN_FILE, RunRecord, Status};
use crate::stage::{self, Ended, RecordingObserver, StageFolder};
use crate::steps::{self, Steps};
use crate::{Error, Observer, StageEvent};
use m4_io::capture::{Split, TRACKS_FILE};
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

/// Creates or reuses the folder of a run, and locks it. With [`Existing::Resume`] returns the earlier record. Fails with an [`OutputError`] for
/// a file of that name, a folder with other things in it, an unexpected earlier run, or one that is running. The capture of an earlier run is kept
/// where it is the `input` of this one.
pub(crate) fn open(folder: &Path, existing: Existing, input: &Path) -> Result<(Lock, Option<RunRecord>), Error> {
    let filled = make(folder)?;
    let lock = Lock::take(folder)?;
    let mut earlier = None;
    if filled {
        let record = RunRecord::read(folder)?;
        let status = record.as_ref().map(|record| record.status);
        let failed = status == Some(Status::Failed) && !has_results(folder);
        let what = if status == Some(Status::Finished) { "a finished run" } else { "an unfinished run" };
        earlier = take_over(folder, existing, record, failed, what, RUN_FILE)?;
        if earlier.is_none() {
            clear(folder, input)?;
        }
    }
    // No other process writes these while the folder is locked.
    let checkpoints = hidden(&folder.join(CHECKPOINT_FOLDER))?.into_iter().map(|(_, path)| path);
    for path in half_written(folder, &OWN_FILES)?.into_iter().chain(checkpoints) {
        remove_file(&path)?;
    }
    Ok((lock, earlier))
}

/// The files that a run writes into its folder, its record first.
const OWN_FILES: [&str; 5] = [RUN_FILE, SCENE_FILE, METRICS_FILE, PREVIEW_FILE, VIEWER_FILE];

/// The temporary files of these names that a killed process left ([`m4_io::atomic`]).
fn half_written(folder: &Path, names: &[&str]) -> Result<Vec<PathBuf>, Error> {
    let found = hidden(folder)?;
    let ours = |name: &str| names.iter().any(|own| m4_io::atomic::is_temporary_of(name, own));
    Ok(found.into_iter().filter(|(name, _)| ours(name)).map(|(_, path)| path).collect())
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

/// The record of an earlier run or capture to resume; `None` to replace it. An attempt that `failed` and left nothing worth keeping is
/// replaced. `what` the folder holds and the file that is `missing` without a record are for the messages.
fn take_over<R>(
    folder: &Path,
    existing: Existing,
    record: Option<R>,
    failed: bool,
    what: &'static str,
    missing: &'static str,
) -> Result<Option<R>, Error> {
    let path = folder.to_path_buf();
    match (record, existing) {
        (Some(record), Existing::Resume) => Ok(Some(record)),
        (_, Existing::Force) => Ok(None),
        (Some(_), Existing::Refuse) if failed => Ok(None),
        (Some(_), Existing::Refuse) => Err(OutputError::Exists { path, what }.into()),
        (None, _) => Err(OutputError::NotOurs { path, missing }.into()),
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
    /// Locks the folder itself, so that no lock file is left behind; without effect on systems that cannot lock a folder.
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

/// Removes the files of a run without its `input`, and nothing else. The record stays until a new one replaces it.
fn clear(folder: &Path, input: &Path) -> Result<(), Error> {
    for file in [SCENE_FILE, METRICS_FILE, PREVIEW_FILE, VIEWER_FILE, EVAL_FILE] {
        remove_file(&folder.join(file))?;
    }
    remove_checkpoints(folder)?;
    let capture = folder.join(CAPTURE_FOLDER);
    if capture.is_dir() && !lies_in(input, &capture) {
        clear_capture(&capture)?;
    }
    Ok(())
}

/// Whether both exist, and `path` is `folder` or in it.
fn lies_in(path: &Path, folder: &Path) -> bool {
    let inside = || Some(path.canonicalize().ok()?.starts_with(folder.canonicalize().ok()?));
    inside().unwrap_or(false)
}

/// Removes a file that may be missing.
pub(crate) fn remove_file(path: &Path) -> Result<(), Error> {
    may_be_missing(fs::remove_file(path), path)
}

/// Removes a folder with what is in it, which may be missing.
pub(crate) fn remove_folder(path: &Path) -> Result<(), Error> {
    may_be_missing(fs::remove_dir_all(path), path)
}

fn may_be_missing(removed: std::io::Result<()>, path: &Path) -> Result<(), Error> {
    match removed {
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

/// The folder of a capture while a stage writes it.
pub(crate) struct CaptureFolder<'a> {
    pub path: PathBuf,
    /// Seconds and warnings in it when the stage begins are those of its preparation.
    pub record: GeometryRecord,
    /// The record of an earlier run that may be resumed.
    earlier: Option<GeometryRecord>,
    observer: &'a dyn Observer,
    _lock: Lock,
}

impl<'a> CaptureFolder<'a> {
    /// Creates or reuses the folder for the stage that `record` describes; fails if it is in use, holds something else, or cannot be written, and
    /// where the stage would remove its own input.
    pub fn open(
        path: &Path,
        existing: Existing,
        record: GeometryRecord,
        observer: &'a dyn Observer,
    ) -> Result<Self, Error> {
        let input = Path::new(&record.input.path);
        if Split::Train.folders().iter().any(|name| lies_in(input, &path.join(name))) {
            return Err(OutputError::HoldsInput { path: input.to_path_buf() }.into());
        }
        let filled = make(path)?;
        let lock = Lock::take(path)?;
        let earlier = if filled {
            let record = GeometryRecord::read(path)?;
            let failed = record.as_ref().is_some_and(|record| record.status == Status::Failed);
            take_over(path, existing, record, failed, "a capture", GEOMETRY_FILE)?
        } else {
            None
        };
        let own = [GEOMETRY_FILE, Split::Train.file_name(), TRACKS_FILE, REPORT_FILE];
        for torn in half_written(path, &own)? {
            remove_file(&torn)?;
        }
        Ok(Self { path: path.to_path_buf(), record, earlier, observer, _lock: lock })
    }

    /// Returns the record of an earlier run whose result is complete and has the same key.
    pub fn reused(&self, stage: &str) -> Option<GeometryRecord> {
        let earlier = self.earlier.as_ref().filter(|earlier| self.is_result(earlier))?;
        self.observer.stage(stage, StageEvent::Reused);
        Some(earlier.clone())
    }

    /// Returns whether the capture is the complete result of the stage.
    fn is_result(&self, earlier: &GeometryRecord) -> bool {
        earlier.key == self.record.key
            && earlier.status == Status::Finished
            && self.path.join(Split::Train.file_name()).is_file()
    }

    /// Runs the stage, which writes the capture. Finished steps of an interrupted attempt are used, and removed with the last one.
    pub fn stage<R>(
        &mut self,
        stage: &'static str,
        work: impl FnOnce(&mut Self, &Steps<'_>) -> Result<R, Error>,
    ) -> Result<R, Error> {
        let outdated = self.earlier.as_ref().filter(|earlier| !self.is_result(earlier));
        let because = outdated.map(|earlier| why_again(earlier, &self.record));
        stage::run(self, stage, because, |folder, recorder: &RecordingObserver<'_>| {
            clear_results(&folder.path)?;
            let steps = Steps::open(&folder.path, &folder.record.key, recorder);
            let outcome = work(folder, &steps);
            if outcome.as_ref().err().is_none_or(|error| !error.is_stop() && !error.may_pass()) {
                steps.remove();
            }
            outcome
        })
    }
}

impl<'a> StageFolder<'a> for CaptureFolder<'a> {
    fn observer(&self) -> &'a dyn Observer {
        self.observer
    }

    fn begin(&mut self, _: &'static str) -> Result<(), Error> {
        // Before anything else: a folder with anything of ours in it always has a record.
        self.record.write(&self.path)
    }

    fn end(&mut self, _: &'static str, ended: &Ended) -> Result<(), Error> {
        self.record.status = ended.status;
        self.record.seconds += ended.seconds;
        for warning in &ended.warnings {
            if !self.record.warnings.contains(warning) {
                self.record.warnings.push(warning.clone());
            }
        }
        self.record.write(&self.path)
    }
}

fn why_again(earlier: &GeometryRecord, now: &GeometryRecord) -> &'static str {
    if earlier.input.blake3 != now.input.blake3 {
        "because the input changed"
    } else if earlier.settings != now.settings {
        "because its settings changed"
    } else if earlier.status != Status::Finished {
        "because it was not finished; its finished steps are used"
    } else {
        "because its files are not complete or another version made them"
    }
}

/// Removes a list of frames and what it names.
pub(crate) fn clear_split(capture: &Path, split: Split) -> Result<(), Error> {
    remove_file(&capture.join(split.file_name()))?;
    for name in split.folders() {
        remove_folder(&capture.join(name))?;
    }
    Ok(())
}

/// Removes what a stage writes into a capture, and nothing else.
pub(crate) fn clear_capture(capture: &Path) -> Result<(), Error> {
    if GeometryRecord::read(capture)?.is_none() {
        return Ok(());
    }
    clear_results(capture)?;
    steps::remove(capture);
    remove_file(&capture.join(GEOMETRY_FILE))
}

/// Removes the same but for the record and the finished steps.
fn clear_results(capture: &Path) -> Result<(), Error> {
    clear_split(capture, Split::Train)?;
    remove_file(&capture.join(TRACKS_FILE))?;
    remove_file(&capture.join(REPORT_FILE))
}
