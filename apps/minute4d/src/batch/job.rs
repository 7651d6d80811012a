//! Runs one job, and publishes or records its result.
//!
//! A machine's fault is never charged to the clip. Only one end of a run is a permanent failure:
//! its exit code says that the input is bad, nothing of an earlier attempt was used, and the input
//! still has the bytes that were planned. Everything else may succeed on another machine or later,
//! so the job may be started again.

use crate::batch::child::{self, Ended};
use crate::batch::layout::{JobRecord, Layout, Outcome};
use crate::batch::manifest::{Job, Manifest, VERSION};
use crate::batch::not_ours;
use crate::batch::publish::{Present, Published, present, publish, recover, remove};
use crate::run::record::RUN_FILE;
use m4_core::Progress;
use m4_io::{atomic, files};
use minute4d::json::{MAX_RECORD_BYTES, write_json};
use minute4d::{Category, Error, Refusal, hash};
use serde_json::Value;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

/// Where schedulers say which job of an array this is: Slurm, Kubernetes.
pub const INDEX_VARIABLES: [&str; 2] = ["SLURM_ARRAY_TASK_ID", "JOB_COMPLETION_INDEX"];
/// Exit code of a run whose input is bad.
const BAD_INPUT: i32 = 65;
/// Time to wait for another process with the same job, or for the children of a killed one.
const LET_GO: Duration = Duration::from_secs(120);

/// The environment of a job.
pub struct Tools {
    /// The program whose `run` makes a scene.
    pub program: PathBuf,
    /// Arguments for the run that do not change its result, such as `--threads 2`.
    pub arguments: Vec<String>,
    /// Name of this machine.
    pub host: String,
}

/// The outcome of a job.
#[derive(Debug, Clone, PartialEq)]
pub struct JobEnd {
    /// The outcome.
    pub outcome: Outcome,
    /// Why; empty where it is done.
    pub reason: String,
    /// Wall-clock seconds; `None` where it had ended before.
    pub seconds: Option<f64>,
}

/// The first index that a scheduler gives, if one does; an error for a variable that is no number.
pub fn index_of_environment(get: impl Fn(&str) -> Option<String>) -> Result<Option<usize>, Error> {
    for name in INDEX_VARIABLES {
        if let Some(value) = get(name).filter(|v| !v.is_empty()) {
            let index = value.parse().map_err(|_| {
                let message = format!("{name}={value:?} is not the index of a job; give --index");
                Refusal::new(Category::NoInput, message)
            })?;
            return Ok(Some(index));
        }
    }
    Ok(None)
}

/// Runs a job, unless it is done or failed permanently; `retry_failed` runs it in that case, too.
/// It continues where an interrupted run of it stopped.
///
/// # Errors
///
/// [`Error`] where nothing is known of the job; what goes wrong with it is its [`JobEnd`].
pub fn run_job(
    manifest: &Manifest,
    index: usize,
    retry_failed: bool,
    tools: &Tools,
    watch: &dyn Progress,
) -> Result<JobEnd, Error> {
    let jobs = manifest.jobs.len();
    let job = manifest.jobs.get(index).ok_or_else(|| {
        let message = format!("there is no job {index}: the manifest lists {jobs}, counted from 0");
        Refusal::new(Category::NoInput, message)
    })?;
    let attempt = Attempt {
        job,
        manifest,
        key: job.key(&manifest.run),
        layout: Layout::new(Path::new(&manifest.results)),
        tools,
        watch,
    };
    // Before anything is written: where disks are not mounted, their folders must stay empty.
    let states = attempt.layout.states();
    if !states.is_dir() {
        let message = "the folder of results is not mounted here, or was removed; `minute4d batch plan --force` makes it again";
        return Ok(again(&format!(
            "there is no {}: {message}",
            states.display()
        )));
    }
    if let Some(end) = attempt.ended_before(retry_failed)? {
        return Ok(end);
    }
    if let Err(reason) = attempt.check_input() {
        return Ok(again(&reason));
    }
    let lock = attempt.layout.lock(&job.id);
    let Some(_lock) = lock_file(&lock)
        .and_then(|file| Ok(wait_for(&file, watch)?.then_some(file)))
        .map_err(Error::write(&lock))?
    else {
        return Ok(again(
            "another process runs this job, or this one was asked to stop",
        ));
    };
    if let Some(end) = attempt.ended_before(retry_failed)? {
        return Ok(end);
    }
    let start = Instant::now();
    let failed = |error: Error| (again(&error.to_string()), None);
    let (mut end, code) = attempt.make().unwrap_or_else(failed);
    let seconds = start.elapsed().as_secs_f64();
    end.seconds = Some(seconds);
    let record = JobRecord {
        version: VERSION,
        id: job.id.clone(),
        key: attempt.key,
        outcome: end.outcome,
        reason: end.reason.clone(),
        code,
        seconds,
        host: tools.host.clone(),
    };
    match write_json(&attempt.layout.state(&job.id), &record) {
        // A failure that is not recorded would be run again and again; the others are known
        // without.
        Err(error) if end.outcome == Outcome::Failed => Err(error),
        _ => Ok(end),
    }
}

/// An end after which the job may be tried again.
fn again(reason: &str) -> JobEnd {
    JobEnd {
        outcome: Outcome::Retryable,
        reason: reason.to_owned(),
        seconds: None,
    }
}

struct Attempt<'a> {
    job: &'a Job,
    manifest: &'a Manifest,
    key: String,
    layout: Layout,
    tools: &'a Tools,
    watch: &'a dyn Progress,
}

impl Attempt<'_> {
    /// What is known of a job that need not be run.
    fn ended_before(&self, retry_failed: bool) -> Result<Option<JobEnd>, Error> {
        let end = |outcome, reason| {
            Some(JobEnd {
                outcome,
                reason,
                seconds: None,
            })
        };
        if present(&self.layout.result(&self.job.id), &self.key)? == Present::Same {
            return Ok(end(Outcome::Done, String::new()));
        }
        let record = JobRecord::read(&self.layout.state(&self.job.id), &self.key)?;
        let failed = record.filter(|r| r.outcome == Outcome::Failed && !retry_failed);
        Ok(failed.and_then(|r| end(Outcome::Failed, r.reason)))
    }

    /// Runs and publishes; with the exit code of the run, where it had one.
    fn make(&self) -> Result<(JobEnd, Option<i32>), Error> {
        let (id, work) = (&self.job.id, self.layout.work(&self.job.id));
        if present(&self.layout.result(id), &self.key)? == Present::NotOurs {
            return Ok((again(&self.in_the_way()), None));
        }
        recover(&self.layout, id)?;
        if !free(&work, self.watch).map_err(Error::write(&work))? {
            let message = format!(
                "another run is using {}, or this one was asked to stop",
                work.display()
            );
            return Ok((again(&message), None));
        }
        let mut fresh = !work.exists();
        loop {
            let Ended {
                code,
                reason,
                asked,
            } = self.run()?;
            let end = match code {
                Some(0) => match publish(&self.layout, id, &self.key, &self.tools.host)? {
                    Published::Yes => JobEnd {
                        outcome: Outcome::Done,
                        ..again("")
                    },
                    Published::Bad(message) => {
                        again(&format!("the result was not published: {message}"))
                    }
                    Published::NotOurs => again(&self.in_the_way()),
                },
                _ if asked => again("it was asked to stop"),
                Some(BAD_INPUT) if !fresh => {
                    // What an earlier attempt left may be what is bad.
                    remove(&work)?;
                    fresh = true;
                    continue;
                }
                Some(BAD_INPUT) => match self.check_input() {
                    Ok(()) => JobEnd {
                        outcome: Outcome::Failed,
                        ..again(&reason)
                    },
                    Err(changed) => again(&format!("{changed}, and {reason}")),
                },
                _ => again(&reason),
            };
            if end.outcome != Outcome::Retryable {
                // What stays costs room alone.
                let _ = fs::remove_file(self.layout.settings(id));
                let _ = remove(&work);
            }
            return Ok((end, code));
        }
    }

    fn run(&self) -> Result<Ended, Error> {
        let id = &self.job.id;
        let (settings, log) = (self.layout.settings(id), self.layout.log(id));
        let run = &self.manifest.run;
        atomic::write(&settings, run.settings.as_bytes()).map_err(Error::write(&settings))?;
        let log = open_log(&log).map_err(Error::write(&log))?;
        let mut command = Command::new(&self.tools.program);
        command
            .arg("run")
            .args(["--resume", "--json", "--stop-at-eof", "--poster"])
            .args(&run.arguments)
            .args(&self.tools.arguments)
            .arg("--config")
            .arg(&settings)
            .arg("--out")
            .arg(self.layout.work(id))
            .arg("--")
            .arg(&self.job.input);
        child::run(command, log, self.watch).map_err(Error::read(&self.tools.program))
    }

    /// The message for a folder that is not ours where a result should go.
    fn in_the_way(&self) -> String {
        not_ours(&self.layout.result(&self.job.id)).to_string()
    }

    /// The input must be what was planned: results are kept under its hash. What is missing here,
    /// or is another, is so on this machine: its disks may not be mounted.
    fn check_input(&self) -> Result<(), String> {
        let input = &self.job.input;
        match hash::of_input(Path::new(input), None, self.watch) {
            Err(error) => Err(error.to_string()),
            Ok(hash) if hash != self.job.blake3 => Err(format!(
                "{input} is not what was planned; if it changed, plan again"
            )),
            Ok(_) => Ok(()),
        }
    }
}

fn lock_file(path: &Path) -> io::Result<File> {
    make_parent(path)?;
    OpenOptions::new()
        .create(true)
        .truncate(false)
        .write(true)
        .open(path)
}

fn open_log(path: &Path) -> io::Result<File> {
    make_parent(path)?;
    OpenOptions::new().create(true).append(true).open(path)
}

fn make_parent(path: &Path) -> io::Result<()> {
    path.parent().map_or(Ok(()), fs::create_dir_all)
}

/// Locks a file as soon as no other process holds it; false where that takes too long. File systems
/// without locks go without: there two processes with one job hinder each other, and still publish
/// whole results alone.
fn wait_for(file: &File, watch: &dyn Progress) -> io::Result<bool> {
    let start = Instant::now();
    while let Err(TryLockError::WouldBlock) = file.try_lock() {
        if watch.cancelled() || start.elapsed() > LET_GO {
            return Ok(false);
        }
        thread::sleep(Duration::from_millis(100));
    }
    Ok(true)
}

/// Waits until no run has the working folder, and clears away one that no run can resume: killed
/// before it wrote what it is. False where it is not available.
fn free(work: &Path, watch: &dyn Progress) -> io::Result<bool> {
    let folder = match File::open(work) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(true),
        folder => folder?,
    };
    if !wait_for(&folder, watch)? {
        return Ok(false);
    }
    let is_record = |text: Vec<u8>| {
        serde_json::from_slice::<Value>(&text).is_ok_and(|v| v["format"].is_string())
    };
    if !files::read(&work.join(RUN_FILE), MAX_RECORD_BYTES).is_ok_and(is_record) {
        fs::remove_dir_all(work)?;
    }
    Ok(true)
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
