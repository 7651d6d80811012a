//! A run in progress: its folder, its record, and its observer.

use crate::run::Clock;
use crate::run::Job;
use crate::run::folder::RunFolder;
use crate::run::record::{
    Device, FileRecord, Input, RunRecord, StageRecord, Status, peak_memory_bytes,
};
use crate::run::stage::{self, Ended, StageFolder};
use m4_kernels::SimdLevel;
use minute4d::device::OpenGpu;
use minute4d::observer::RecordingObserver;
use minute4d::{Error, Observer, hash};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A run in progress.
pub(crate) struct Workspace<'a> {
    /// Where the run works, which is not the place of its results where it replaces older ones.
    pub folder: PathBuf,
    results: RunFolder,
    pub job: &'a Job<'a>,
    pub level: SimdLevel,
    /// The GPU to train on; `None` for the CPU.
    pub gpu: Option<OpenGpu>,
    pub record: RunRecord,
    /// The record of an earlier run that this one resumes.
    pub earlier: Option<RunRecord>,
    /// The time limit.
    pub clock: Clock,
    /// The time from which an optional stage is asked to stop.
    until: Option<Instant>,
    room: Option<Room>,
}

/// Reserved disk space, so that the record can be written when the disk is full; free when this is
/// dropped.
struct Room(PathBuf);

/// More than the size of a record, bytes.
const ROOM: usize = 1 << 18;

impl Room {
    /// Reserves the space if possible; otherwise the error appears at the next write.
    fn reserve(folder: &Path) -> Self {
        let path = folder.join(".minute4d-room");
        if fs::write(&path, vec![0xa5; ROOM]).is_err() {
            let _ = fs::remove_file(&path);
        }
        Self(path)
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

/// The task of a stage.
pub(crate) enum Task {
    /// Nothing: an earlier result is complete and has the same input and settings.
    Reuse,
    /// The whole stage, or the rest of an interrupted one, after this many earlier seconds.
    Work {
        because: Option<&'static str>,
        seconds_before: f64,
    },
}

impl<'a> Workspace<'a> {
    /// Creates or reuses a folder and records the start of the run with the input `file`.
    pub fn open(
        path: &Path,
        file: &Path,
        input: Input,
        job: &'a Job<'a>,
        clock: Clock,
    ) -> Result<Self, Error> {
        let level = job.check()?;
        let gpu = job.device.choice.open(|why| job.observer.warn(why))?;
        let mut record = RunRecord::begin(
            input,
            &job.settings,
            Device::here(level, gpu.as_ref().map(OpenGpu::name)),
        )?;
        let files = job.settings.geometry.files();
        let inputs: Vec<&Path> = [file].into_iter().chain(files).collect();
        let (results, earlier) = RunFolder::open(path, job.existing, &record, &inputs)?;
        let folder = results.path().to_path_buf();
        if let Some(earlier) = &earlier {
            record.stages = earlier.stages.clone();
            record.files = earlier.files.clone();
            record.splats = earlier.splats;
            record.iterations = earlier.iterations;
        }
        record.write(&folder)?;
        let room = Some(Room::reserve(&folder));
        Ok(Self {
            folder,
            results,
            job,
            level,
            gpu,
            record,
            earlier,
            clock,
            until: None,
            room,
        })
    }

    /// Runs the work and records its end.
    pub fn finish(
        mut self,
        work: impl FnOnce(&mut Self) -> Result<(), Error>,
    ) -> Result<RunRecord, Error> {
        let outcome = work(&mut self);
        match &outcome {
            Ok(()) => self.record.status = Status::Finished,
            Err(error) => {
                self.record.status = if error.is_stop() {
                    Status::Stopped
                } else {
                    Status::Failed
                };
                self.record.error = Some(error.to_string());
            }
        }
        self.room = None;
        let written = self.record.write(&self.folder);
        outcome?;
        written?;
        self.results.commit()?;
        Ok(self.record)
    }

    /// Runs an optional stage, which is skipped with a note when the time is up.
    pub fn if_there_is_time(
        &mut self,
        what: &str,
        stage: impl FnOnce(&mut Self) -> Result<(), Error>,
    ) -> Result<(), Error> {
        self.until = self.clock.end();
        let outcome = if self.clock.is_over() {
            Err(Error::Stopped {
                stage: "",
                saved: true,
            })
        } else {
            stage(self)
        };
        self.until = None;
        match outcome {
            Err(error)
                if error.is_stop() && self.clock.is_over() && !self.job.observer.cancelled() =>
            {
                self.job.observer.warn(&format!(
                    "the time limit left none for {what}; the same command with --resume makes it"
                ));
                Ok(())
            }
            other => other,
        }
    }

    /// Where the results are when the run is complete.
    pub fn place(&self) -> &Path {
        self.results.place()
    }

    /// A file of the run.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Returns whether a stage with this key is done and its files are unchanged.
    pub fn task(&self, stage: &str, key: &str, files: &[&str]) -> Result<Task, Error> {
        let Some(earlier) = self.record.stages.get(stage) else {
            return Ok(Task::Work {
                because: None,
                seconds_before: 0.0,
            });
        };
        let because = if earlier.key != key {
            Some(self.why_again())
        } else if !earlier.done {
            None
        } else if !self.intact(files)? {
            Some("because its files are missing or were changed")
        } else {
            return Ok(Task::Reuse);
        };
        Ok(Task::Work {
            because,
            seconds_before: if because.is_none() {
                earlier.seconds
            } else {
                0.0
            },
        })
    }

    fn why_again(&self) -> &'static str {
        let Some(earlier) = &self.earlier else {
            return "because something changed";
        };
        if earlier.input.blake3 != self.record.input.blake3 {
            "because the input changed"
        } else if earlier.settings != self.record.settings {
            "because the settings changed"
        } else if earlier.device.simd != self.record.device.simd {
            "because the vector instructions changed"
        } else if earlier.minute4d != self.record.minute4d {
            "because another version made it"
        } else {
            "because what it starts from changed"
        }
    }

    fn intact(&self, files: &[&str]) -> Result<bool, Error> {
        for &name in files {
            let path = self.path(name);
            let same = match self.record.files.get(name) {
                Some(file) if path.is_file() => hash::of_path(&path)? == file.blake3,
                _ => false,
            };
            if !same {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Runs a stage that writes `files`: records its seconds, warnings and files.
    pub fn stage<R>(
        &mut self,
        name: &'static str,
        key: String,
        (because, seconds): (Option<&'static str>, f64),
        files: &[&str],
        work: impl FnOnce(&mut Self, &RecordingObserver<'_>) -> Result<R, Error>,
    ) -> Result<R, Error> {
        let begun = StageRecord {
            key,
            done: false,
            seconds,
            peak_memory_bytes: None,
            warnings: Vec::new(),
        };
        self.record.stages.insert(name.to_owned(), begun);
        stage::run(self, name, because, |run, recorder| {
            let result = work(run, recorder)?;
            for &file in files {
                let written = FileRecord::of(&run.path(file))?;
                run.record.files.insert(file.to_owned(), written);
            }
            Ok(result)
        })
    }
}

impl<'a> StageFolder<'a> for Workspace<'a> {
    fn observer(&self) -> &'a dyn Observer {
        self.job.observer
    }

    fn until(&self) -> Option<Instant> {
        self.until
    }

    fn begin(&mut self, _: &'static str) -> Result<(), Error> {
        self.record.write(&self.folder)
    }

    fn end(&mut self, name: &'static str, ended: &Ended) -> Result<(), Error> {
        if let Some(stage) = self.record.stages.get_mut(name) {
            stage.seconds += ended.seconds;
            stage.peak_memory_bytes = peak_memory_bytes();
            stage.warnings.clone_from(&ended.warnings);
            stage.done = ended.status == Status::Finished;
        }
        match ended.status {
            Status::Finished => self.record.write(&self.folder),
            // `finish` writes it, once the reserved space is free
            _ => Ok(()),
        }
    }
}
