//! A worker: takes jobs, has them done, publishes what came of them.

use crate::child::{self, Ended, Watch};
use crate::error::{FileError, WorkError};
use crate::layout::Layout;
use crate::lease::{self, Holder, Lease, Taken};
use crate::manifest::{Job, Manifest};
use crate::publish::{Present, Published, present, publish};
use crate::record::{JobRecord, Verdict, now_s};
use crate::share::Share;
use crate::verdict::{Meaning, meaning};
use m4_io::atomic;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

/// Workers that may vanish over a job, for each attempt that may crash. Machines go away for reasons of their own.
const VANISHED_AN_ATTEMPT: u32 = 3;
/// Exit code of a run that found no device.
const NO_DEVICE: i32 = 69;
/// Exit code of a run that could not write.
const CANNOT_WRITE: i32 = 73;
/// How long to wait for the run of a vanished worker to let go of the working folder.
const LET_GO: Duration = Duration::from_secs(120);

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
        worker.rest();
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

/// How one attempt ended.
enum Attempt {
    Ended(Ended),
    /// The job is another's by now.
    Lost,
    /// No run was started.
    Refused(Meaning, i32, String),
}

struct Worker<'a> {
    manifest: &'a Manifest,
    layout: Layout,
    options: &'a WorkOptions,
    tools: &'a Tools<'a>,
    listener: &'a dyn Listener,
    me: Holder,
}

impl Worker<'_> {
    /// Does a job, unless it is done; `None` where another has it.
    fn job(&self, job: &Job) -> Result<Option<JobEnd>, WorkError> {
        let key = job.key(&self.manifest.run);
        let retry = self.options.retry_failed;
        if let Some(end) = self.ended_before(job, &key, retry)? {
            return Ok(Some(end));
        }
        let (lease, vanished) = match lease::take(&self.layout.leases(&job.id), self.options.lease, &self.me)? {
            Taken::Held(_) => return Ok(None),
            Taken::Mine { lease, vanished } => (lease, vanished),
        };
        // Another may have ended it between the first look and the lease.
        let end = self.ended_before(job, &key, retry).map_err(WorkError::from);
        let end = end.and_then(|end| match end {
            Some(end) => Ok(Some(end)),
            None => self.attempts(job, &key, &lease, vanished.is_some()),
        });
        let released = lease.release();
        let end = end?;
        released?;
        Ok(end)
    }

    /// What is known of a job that need not be done.
    fn ended_before(&self, job: &Job, key: &str, retry: bool) -> Result<Option<JobEnd>, FileError> {
        if present(&self.layout.result(&job.id), key)? == Present::Same {
            return Ok(Some(JobEnd::Done { seconds: None }));
        }
        let record = JobRecord::read(&self.layout.state(&job.id), key)?;
        let poison = record.filter(|r| r.verdict == Verdict::Poison && !retry);
        Ok(poison.map(|r| JobEnd::Poison { reason: r.reason }))
    }

    /// Tries until it is done, given up or given back; `None` where the lease was lost.
    fn attempts(&self, job: &Job, key: &str, lease: &Lease, vanished: bool) -> Result<Option<JobEnd>, WorkError> {
        let path = self.layout.state(&job.id);
        let fresh = || JobRecord::new(&job.id, key, &self.tools.host);
        let mut record = match JobRecord::read(&path, key)? {
            Some(old) if old.verdict == Verdict::Poison => fresh(),
            old => old.unwrap_or_else(fresh),
        };
        record.vanished += u32::from(vanished);
        loop {
            let start = Instant::now();
            let limit = self.options.attempts.max(1);
            let attempt = if record.vanished >= limit.saturating_mul(VANISHED_AN_ATTEMPT) {
                let said = format!("{} workers vanished while they were at it", record.vanished);
                Attempt::Refused(Meaning::Poison, 1, said)
            } else {
                self.attempt(job, lease)?
            };
            let (how, code, mut reason) = match attempt {
                Attempt::Lost => return Ok(None),
                Attempt::Refused(how, code, reason) => (how, Some(code), reason),
                Attempt::Ended(ended) if ended.asked && ended.code != Some(0) => (
                    Meaning::GiveBack,
                    ended.code,
                    "this worker was asked to stop".to_owned(),
                ),
                Attempt::Ended(ended) => (meaning(ended.code), ended.code, ended.reason),
            };
            let mut verdict = match how {
                Meaning::Done => Verdict::Done,
                Meaning::Poison => Verdict::Poison,
                Meaning::GiveBack => Verdict::Interrupted,
                Meaning::Crash => Verdict::Failed,
            };
            if verdict == Verdict::Done {
                match publish(&self.layout, &job.id, key, &self.tools.host, lease)? {
                    Published::Yes => {}
                    Published::Lost => return Ok(None),
                    Published::Bad(said) => {
                        (verdict, reason) = (Verdict::Failed, format!("the result was not published: {said}"));
                    }
                    Published::Foreign => (verdict, reason) = (Verdict::Poison, self.in_the_way(job)),
                }
            }
            if verdict == Verdict::Failed {
                record.attempts += 1;
                if record.attempts >= limit {
                    verdict = Verdict::Poison;
                    reason = format!("given up after {} attempts: {reason}", record.attempts);
                }
            }
            (record.verdict, record.code) = (verdict, code);
            record.reason.clone_from(&reason);
            record.seconds = start.elapsed().as_secs_f64();
            (record.host, record.when_s) = (self.tools.host.clone(), now_s());
            // Nobody else may write here: not even the record of a job that was taken over meanwhile.
            if lease.is_lost() {
                return Ok(None);
            }
            record.write(&path)?;
            match verdict {
                Verdict::Done => {
                    let _ = fs::remove_file(self.layout.settings(&job.id));
                    return Ok(Some(JobEnd::Done {
                        seconds: Some(record.seconds),
                    }));
                }
                Verdict::Poison => return Ok(Some(JobEnd::Poison { reason })),
                Verdict::Interrupted => {
                    let machine = matches!(code, Some(NO_DEVICE | CANNOT_WRITE));
                    return Ok(Some(JobEnd::Again { reason, machine }));
                }
                Verdict::Failed => {}
            }
        }
    }

    /// One run.
    fn attempt(&self, job: &Job, lease: &Lease) -> Result<Attempt, WorkError> {
        let guard = Guard {
            id: &job.id,
            lease,
            listener: self.listener,
        };
        if let Some(refused) = self.check_input(job) {
            return Ok(refused);
        }
        if present(&self.layout.result(&job.id), "")? == Present::Foreign {
            return Ok(Attempt::Refused(Meaning::Poison, CANNOT_WRITE, self.in_the_way(job)));
        }
        let (work, settings) = (self.layout.work(&job.id), self.layout.settings(&job.id));
        let failed = FileError::write(&settings);
        match free(&work, &guard) {
            Err(source) => return Err(FileError::Write { path: work, source }.into()),
            Ok(false) if lease.is_lost() => return Ok(Attempt::Lost),
            Ok(false) => {
                let said = format!(
                    "another run is at work in {}, or this worker was asked to stop",
                    work.display()
                );
                return Ok(Attempt::Refused(Meaning::GiveBack, 75, said));
            }
            Ok(true) => {}
        }
        atomic::write(&settings, self.manifest.run.settings.as_bytes()).map_err(failed)?;
        let log = self.layout.log(&job.id);
        let log = open_log(&log).map_err(FileError::write(&log))?;
        let mut command = Command::new(&self.tools.program);
        command
            .arg("run")
            .args(["--resume", "--json", "--stop-at-eof", "--poster"])
            .args(&self.manifest.run.arguments)
            .args(&self.tools.arguments)
            .arg("--config")
            .arg(&settings)
            .arg("--out")
            .arg(&work)
            .arg("--")
            .arg(&job.input);
        let ended = child::run(command, log, &guard).map_err(FileError::read(&self.tools.program))?;
        Ok(if lease.is_lost() {
            Attempt::Lost
        } else {
            Attempt::Ended(ended)
        })
    }

    /// What is said of a folder that is not ours where a result should go.
    fn in_the_way(&self, job: &Job) -> String {
        let place = self.layout.result(&job.id);
        format!(
            "{} is there and was not made by `minute4d batch`; move it away and use --retry-failed",
            place.display()
        )
    }

    /// The input must be what was planned: results are kept under its hash.
    fn check_input(&self, job: &Job) -> Option<Attempt> {
        let path = Path::new(&job.input);
        let poison = |code: i32, reason: String| Some(Attempt::Refused(Meaning::Poison, code, reason));
        match fs::metadata(path) {
            Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
                return poison(66, format!("there is no {}", job.input));
            }
            Err(e) => {
                return Some(Attempt::Refused(
                    Meaning::GiveBack,
                    74,
                    format!("cannot read {}: {e}", job.input),
                ));
            }
            Ok(_) => {}
        }
        match (self.tools.hash)(path) {
            Err(reason) => Some(Attempt::Refused(Meaning::GiveBack, 74, reason)),
            Ok(found) if job.blake3.as_ref().is_some_and(|planned| *planned != found) => {
                poison(65, format!("{} changed since it was planned; plan again", job.input))
            }
            Ok(_) => None,
        }
    }

    /// Between two looks at jobs that others have.
    fn rest(&self) {
        let long = (self.options.lease / 4).clamp(Duration::from_millis(200), Duration::from_secs(10));
        let start = Instant::now();
        while start.elapsed() < long && !self.listener.stop() {
            thread::sleep(Duration::from_millis(50));
        }
    }
}

fn open_log(path: &Path) -> io::Result<File> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    OpenOptions::new().create(true).append(true).open(path)
}

/// Watches a run for the worker.
struct Guard<'a> {
    id: &'a str,
    lease: &'a Lease,
    listener: &'a dyn Listener,
}

impl Watch for Guard<'_> {
    fn stop(&self) -> bool {
        self.listener.stop()
    }

    fn lost(&self) -> bool {
        self.lease.is_lost()
    }

    fn progress(&self, phase: &str, done: usize, total: usize, note: &str) {
        self.listener.progress(self.id, phase, done, total, note);
    }
}

/// Waits until no run has the working folder, and clears away one that no run can go on with: killed before it wrote
/// what it is. False where it is not to be had.
fn free(work: &Path, guard: &Guard<'_>) -> io::Result<bool> {
    let start = Instant::now();
    loop {
        let folder = match File::open(work) {
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(true),
            folder => folder?,
        };
        match folder.try_lock() {
            Err(TryLockError::WouldBlock) => {}
            // Systems that do not let a folder be locked go without.
            _ => break,
        }
        if guard.stop() || guard.lost() || start.elapsed() > LET_GO {
            return Ok(false);
        }
        thread::sleep(Duration::from_millis(100));
    }
    let begun = fs::read(work.join(crate::layout::RUN_FILE)).is_ok_and(|text| is_record(&text));
    if !begun {
        fs::remove_dir_all(work)?;
    }
    Ok(true)
}

fn is_record(text: &[u8]) -> bool {
    serde_json::from_slice::<serde_json::Value>(text).is_ok_and(|v| v["format"].is_string())
}
