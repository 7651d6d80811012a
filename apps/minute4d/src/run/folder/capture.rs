//! The folder of a capture while a stage writes it.

use super::{remove_half_written, take_over};
use crate::run::record::{GeometryRecord, Status};
use crate::run::stage::{self, Ended, StageFolder};
use crate::run::steps::StepFolder;
use m4_io::capture::Split;
use m4_io::results::{Kind, ResultFolder};
use minute4d::cache::Steps;
use minute4d::layout::{Existing, GEOMETRY_FILE, capture_names as names};
use minute4d::observer::RecordingObserver;
use minute4d::{Error, Observer, StageEvent};
use std::path::{Path, PathBuf};

/// The folder of a capture while a stage writes it.
pub(crate) struct CaptureFolder<'a> {
    /// Seconds and warnings in it when the stage begins are those of its preparation.
    pub record: GeometryRecord,
    /// The record of an earlier run that may be resumed.
    earlier: Option<GeometryRecord>,
    /// Whether a complete capture is here, which stays as it is until the new one is complete.
    replaces: bool,
    observer: &'a dyn Observer,
    results: ResultFolder,
}

impl<'a> CaptureFolder<'a> {
    /// Creates or reuses the folder for the stage that `record` describes. Fails if it is in use,
    /// contains something else, or cannot be written, and where the stage would replace one of its
    /// `inputs`.
    pub fn open(
        path: &Path,
        existing: Existing,
        record: GeometryRecord,
        inputs: &[&Path],
        observer: &'a dyn Observer,
    ) -> Result<Self, Error> {
        let results = ResultFolder::open(path, Kind::Capture)?;
        results.check_not_itself(inputs)?;
        results.check_inputs(names(), inputs)?;
        let earlier = GeometryRecord::read(path)?;
        let is_complete = path.join(Split::Train.file_name()).is_file();
        let replaces = is_complete
            && earlier
                .as_ref()
                .is_some_and(|earlier| earlier.status == Status::Finished);
        let nothing = !is_complete && !StepFolder::exist(path);
        let what = || {
            if is_complete {
                "a capture"
            } else {
                "finished steps of a capture"
            }
            .to_owned()
        };
        let earlier = take_over(&results, existing, earlier, nothing, what, GEOMETRY_FILE)?;
        results.check_free(names())?;
        remove_half_written(path, &[GEOMETRY_FILE])?;
        Ok(Self {
            record,
            earlier,
            replaces,
            observer,
            results,
        })
    }

    /// The folder that the stage writes the capture into, which gets its place with the end of the
    /// stage.
    pub fn next(&self) -> PathBuf {
        self.results.next()
    }

    /// Returns the record of an earlier run whose result is complete and has the same key.
    pub fn reused(&self, stage: &str) -> Option<GeometryRecord> {
        let earlier = self
            .earlier
            .as_ref()
            .filter(|earlier| self.is_result(earlier))?;
        self.observer.stage(stage, StageEvent::Reused);
        Some(earlier.clone())
    }

    /// Returns whether the capture is the complete result of the stage.
    fn is_result(&self, earlier: &GeometryRecord) -> bool {
        earlier.key == self.record.key
            && earlier.status == Status::Finished
            && self.results.path().join(Split::Train.file_name()).is_file()
    }

    /// Runs the stage, which writes the capture. Finished steps of an interrupted attempt are used,
    /// and removed with the last one.
    pub fn stage<R>(
        &mut self,
        stage: &'static str,
        work: impl FnOnce(&mut Self, Steps<'_>) -> Result<R, Error>,
    ) -> Result<R, Error> {
        let outdated = self
            .earlier
            .as_ref()
            .filter(|earlier| !self.is_result(earlier));
        let because = outdated.map(|earlier| why_again(earlier, &self.record));
        let path = self.results.path().to_path_buf();
        let outcome = stage::run(
            self,
            stage,
            because,
            |folder, recorder: &RecordingObserver<'_>| {
                let cache = StepFolder::open(&path, &folder.record.key, recorder);
                work(folder, Steps::new(recorder, Some(&cache)))
            },
        );
        if outcome
            .as_ref()
            .err()
            .is_none_or(|error| !error.is_stop() && !error.may_pass())
        {
            StepFolder::remove_from(&path);
        }
        outcome
    }
}

impl<'a> StageFolder<'a> for CaptureFolder<'a> {
    fn observer(&self) -> &'a dyn Observer {
        self.observer
    }

    fn begin(&mut self, _: &'static str) -> Result<(), Error> {
        if !self.replaces {
            // Before anything else: a folder with anything of ours in it always has a record.
            self.results.claim([GEOMETRY_FILE])?;
            self.record.write(self.results.path())?;
        }
        self.results.begin()?;
        Ok(())
    }

    fn end(&mut self, _: &'static str, ended: &Ended) -> Result<(), Error> {
        self.record.status = ended.status;
        self.record.seconds += ended.seconds;
        for warning in &ended.warnings {
            if !self.record.warnings.contains(warning) {
                self.record.warnings.push(warning.clone());
            }
        }
        if ended.status == Status::Finished {
            self.record.write(&self.results.next())?;
            self.results.commit(None)?;
            return Ok(());
        }
        self.results.discard()?;
        if self.replaces {
            Ok(())
        } else {
            self.record.write(self.results.path())
        }
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
