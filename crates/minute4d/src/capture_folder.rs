//! The folder of a capture and its record `geometry.json`: which of its files may be replaced, and the stage that writes them.

use crate::error::OutputError;
use crate::folder::{self, Existing, Lock};
use crate::record::{GEOMETRY_FILE, GeometryRecord, Status};
use crate::stage::{self, Ended, RecordingObserver, StageFolder};
use crate::steps::{self, Steps};
use crate::{Error, Observer, StageEvent, enhance};
use m4_io::capture::{Split, TRACKS_FILE};
use std::path::{Path, PathBuf};

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
    /// Creates or reuses the folder for the stage that `record` describes.
    ///
    /// # Errors
    ///
    /// [`Error`]: the folder is in use, holds something else, or cannot be written.
    pub fn open(
        path: &Path,
        existing: Existing,
        record: GeometryRecord,
        observer: &'a dyn Observer,
    ) -> Result<Self, Error> {
        let filled = folder::make(path)?;
        let lock = Lock::take(path)?;
        let earlier = if filled { take_over(path, existing)? } else { None };
        let own = [GEOMETRY_FILE, Split::Train.file_name(), TRACKS_FILE, enhance::REPORT_FILE];
        for torn in folder::half_written(path, &own)? {
            folder::remove_file(&torn)?;
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
    ///
    /// # Errors
    ///
    /// Those of `work`, and of the record.
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

fn take_over(capture: &Path, existing: Existing) -> Result<Option<GeometryRecord>, Error> {
    match (GeometryRecord::read(capture)?, existing) {
        (Some(record), Existing::Resume) => Ok(Some(record)),
        (_, Existing::Force) => Ok(None),
        // A failed attempt left nothing worth keeping.
        (Some(record), Existing::Refuse) if record.status == Status::Failed => Ok(None),
        (Some(_), Existing::Refuse) => {
            Err(OutputError::Exists { path: capture.to_path_buf(), what: "a capture" }.into())
        }
        (None, _) => Err(OutputError::NotOurs { path: capture.to_path_buf(), missing: GEOMETRY_FILE }.into()),
    }
}

/// Removes a list of frames and what it names.
pub(crate) fn clear_split(capture: &Path, split: Split) -> Result<(), Error> {
    folder::remove_file(&capture.join(split.file_name()))?;
    for name in split.folders() {
        folder::remove_folder(&capture.join(name))?;
    }
    Ok(())
}

/// Removes what a stage writes into a capture, and nothing else.
pub(crate) fn clear(capture: &Path) -> Result<(), Error> {
    if GeometryRecord::read(capture)?.is_none() {
        return Ok(());
    }
    clear_results(capture)?;
    steps::remove(capture);
    folder::remove_file(&capture.join(GEOMETRY_FILE))
}

/// Removes the same but for the record and the finished steps.
fn clear_results(capture: &Path) -> Result<(), Error> {
    clear_split(capture, Split::Train)?;
    folder::remove_file(&capture.join(TRACKS_FILE))?;
    folder::remove_file(&capture.join(enhance::REPORT_FILE))
}
