//! A worker: takes jobs, has them done, publishes what came of them.

mod attempt;
mod job;

use crate::error::{FileError, WorkError};
use crate::layout::Layout;
use crate::lease::{self, Holder};
use crate::manifest::Manifest;
use crate::record::now_s;
use crate::share::Share;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

/// How a worker works.
#[derive(Debug, Clone)]
pub struct WorkOptions {
    /// Which jobs are its own.
    pub share: Share,
    /// Where scenes are made; beside the results where it is not given.
    pub scratch: Option<PathBuf>,
    /// How long a lease lasts that is not renewed.
    pub lease: Duration,
    /// Crashes of a job before it is given up.
    pub attempts: u32,
    /// Try again what was given up.
    pub retry_failed: bool,
    /// Wait for jobs that others have, and take them over where they vanish.
    pub wait: bool,
}

/// What a worker works with.
pub struct Tools<'a> {
    /// The program whose `run` makes a scene.
    pub program: PathBuf,
    /// Arguments for every run that do not change its result, such as `--threads 2`.
    pub arguments: Vec<String>,
    /// BLAKE3 of a file or a folder, as the plan has it.
    pub hash: &'a (dyn Fn(&Path) -> Result<String, String> + Sync),
    /// Name of this machine.
    pub host: String,
}

/// Who is told how it goes, and who may say stop.
pub trait Listener: Sync {
    /// True when the worker is to save and stop.
    fn stop(&self) -> bool;
    /// How far the run at work is.
    fn progress(&self, id: &str, phase: &str, done: usize, total: usize, note: &str);
    /// A job ended.
    fn ended(&self, id: &str, end: &JobEnd);
}

/// What came of a job, for this worker.
#[derive(Debug, Clone, PartialEq)]
pub enum JobEnd {
    /// Its result is published; before, where it was not done now.
    Done {
        /// Wall-clock seconds; `None` where it was done before.
        seconds: Option<f64>,
    },
    /// It will never work, and is not tried again.
    Poison {
        /// Why.
        reason: String,
    },
    /// It should be tried again, here or elsewhere.
    Again {
        /// Why.
        reason: String,
        /// True when this machine cannot do other jobs either: it has no device, or nothing can be written.
        machine: bool,
    },
}

/// What a worker did.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Summary {
    /// Jobs of its share.
    pub jobs: usize,
    /// Done by this worker.
    pub done: usize,
    /// Done before, or by others meanwhile.
    pub done_before: usize,
    /// Given up, now or before.
    pub poison: usize,
    /// To be tried again.
    pub again: usize,
    /// What was said of those that are not done.
    pub reasons: Vec<(String, String)>,
}

/// Works through a share of the jobs.
///
/// # Errors
///
/// [`WorkError`] where the worker itself cannot go on; what goes wrong with a clip is recorded.
pub fn work(
    manifest: &Manifest,
    options: &WorkOptions,
    tools: &Tools<'_>,
    listener: &dyn Listener,
) -> Result<Summary, WorkError> {
    let mut waiting = options.share.of(manifest.jobs.len())?;
    let nonce = lease::random().map_err(FileError::read(Path::new("/dev/urandom")))?;
    let worker = Worker {
        manifest,
        layout: Layout::new(Path::new(&manifest.results), options.scratch.as_deref()),
        options,
        tools,
        listener,
        me: Holder {
            nonce,
            host: tools.host.clone(),
            pid: std::process::id(),
            since_s: now_s(),
            released: false,
        },
    };
    let mut summary = Summary {
        jobs: waiting.len(),
        ..Summary::default()
    };
    loop {
        let mut held = Vec::new();
        for (i, &index) in waiting.iter().enumerate() {
            let job = &manifest.jobs[index];
            if listener.stop() {
                summary.leave(&waiting[i..], manifest, &mut held, "this worker was asked to stop");
                return Ok(summary);
            }
            let Some(end) = worker.job(job)? else {
                held.push(index);
                continue;
            };
            listener.ended(&job.id, &end);
            let stop = matches!(end, JobEnd::Again { machine: true, .. });
            summary.count(&job.id, end);
            if stop {
                summary.leave(&waiting[i + 1..], manifest, &mut held, "left for another worker");
                return Ok(summary);
            }
        }
        if held.is_empty() {
            return Ok(summary);
        }
        if !options.wait {
            summary.leave(&[], manifest, &mut held, "another worker has it");
            return Ok(summary);
        }
        waiting = held;
        worker.rest(waiting.len());
    }
}

impl Summary {
    fn count(&mut self, id: &str, end: JobEnd) {
        match end {
            JobEnd::Done { seconds: Some(_) } => self.done += 1,
            JobEnd::Done { seconds: None } => self.done_before += 1,
            JobEnd::Poison { reason } => {
                self.poison += 1;
                self.reasons.push((id.to_owned(), reason));
            }
            JobEnd::Again { reason, .. } => {
                self.again += 1;
                self.reasons.push((id.to_owned(), reason));
            }
        }
    }

    fn leave(&mut self, rest: &[usize], manifest: &Manifest, held: &mut Vec<usize>, reason: &str) {
        held.extend(rest);
        for index in held.drain(..) {
            self.again += 1;
            self.reasons.push((manifest.jobs[index].id.clone(), reason.to_owned()));
        }
    }
}

/// Rest for each job that another worker has, and the longest before looking again.
const LOOK: Duration = Duration::from_millis(500);
const LONGEST_REST: Duration = Duration::from_secs(10);
/// However short leases are.
const LEAST_REST: Duration = Duration::from_millis(200);

/// What a worker needs for every job.
struct Worker<'a> {
    manifest: &'a Manifest,
    layout: Layout,
    options: &'a WorkOptions,
    tools: &'a Tools<'a>,
    listener: &'a dyn Listener,
    me: Holder,
}

impl Worker<'_> {
    /// Between two looks at `held` jobs that others have: the more there are, the longer, for the file server's sake.
    fn rest(&self, held: usize) {
        let each = LOOK.saturating_mul(u32::try_from(held).unwrap_or(u32::MAX));
        let long = each
            .clamp(LOOK, LONGEST_REST)
            .min(self.options.lease / 4)
            .max(LEAST_REST);
        let start = Instant::now();
        while start.elapsed() < long && !self.listener.stop() {
            thread::sleep(Duration::from_millis(50));
        }
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
