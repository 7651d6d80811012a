//! A run in progress: its folder, its record, and its observer.

use crate::run::Clock;
use crate::run::Job;
use crate::run::folder::RunFolder;
use crate::run::record::{
    Device, FileRecord, RunRecord, Source, StageRecord, Status, peak_memory_bytes,
};
use crate::run::stage::{self, Ended, StageFolder};
use m4_kernels::SimdLevel;
use minute4d::device::OpenGpu;
use minute4d::layout::SCENE_FILE;
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

/// The task of a stage: all of it, or the rest of an interrupted one.
pub(crate) struct Task {
    /// The key of the stage.
    key: String,
    /// Why an earlier result is not reused.
    because: Option<&'static str>,
    /// Seconds of earlier attempts.
    pub seconds_before: f64,
}

impl Task {
    /// The whole of a stage that was not done before.
    pub fn new(key: String) -> Self {
        Self {
            key,
            because: None,
            seconds_before: 0.0,
        }
    }
}

impl<'a> Workspace<'a> {
    /// Creates or reuses the folder `path` and records the start of the run.
    pub fn open(
        path: &Path,
        source: &Source<'_>,
        job: &'a Job<'a>,
        clock: Clock,
    ) -> Result<Self, Error> {
        let level = job.check()?;
        let gpu = job.device.choice.open(|why| job.observer.warn(why))?;
        let mut record = RunRecord::begin(
            source.input(),
            &job.settings,
            Device::here(level, gpu.as_ref().map(OpenGpu::name)),
        )?;
        let files = job.settings.geometry.files();
        let inputs: Vec<&Path> = [source.path].into_iter().chain(files).collect();
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

    /// Returns what is to be done for a stage; `None` where an earlier result has the same key and
    /// its files are unchanged.
    pub fn task(&self, stage: &str, key: String, files: &[&str]) -> Result<Option<Task>, Error> {
        let (because, seconds_before) = match self.record.stages.get(stage) {
            None => return Ok(Some(Task::new(key))),
            Some(earlier) if earlier.key != key => (Some(self.why_again()), 0.0),
            Some(earlier) if !earlier.done => (None, earlier.seconds),
            Some(_) if self.intact(files)? => return Ok(None),
            Some(_) => (Some("because its files are missing or were changed"), 0.0),
        };
        Ok(Some(Task {
            key,
            because,
            seconds_before,
        }))
    }

    /// The hash of the scene of the run; empty before there is one.
    pub fn scene_hash(&self) -> &str {
        let scene = self.record.files.get(SCENE_FILE);
        scene.map_or("", |file| &file.blake3)
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
        task: Task,
        files: &[&str],
        work: impl FnOnce(&mut Self, &RecordingObserver<'_>) -> Result<R, Error>,
    ) -> Result<R, Error> {
        let begun = StageRecord {
            key: task.key,
            done: false,
            seconds: task.seconds_before,
            peak_memory_bytes: None,
            warnings: Vec::new(),
        };
        self.record.stages.insert(name.to_owned(), begun);
        stage::run(self, name, task.because, |run, recorder| {
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
