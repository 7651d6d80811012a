//! One run of one job.

use super::{Listener, Worker};
use crate::child::{self, Ended, Watch};
use crate::credentials;
use crate::error::{FileError, WorkError};
use crate::layout::RUN_FILE;
use crate::lease::Lease;
use crate::manifest::Job;
use crate::publish::{Present, present};
use crate::verdict::Meaning;
use m4_io::atomic;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind};
use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

/// Exit code of a run that found no device.
pub(super) const NO_DEVICE: i32 = 69;
/// Exit code of a run that could not write.
pub(super) const CANNOT_WRITE: i32 = 73;
/// Exit code of a run that could not read.
pub(super) const CANNOT_READ: i32 = 74;
/// How long to wait for the run of a vanished worker to let go of the working folder.
const LET_GO: Duration = Duration::from_secs(120);

/// How one attempt ended.
pub(super) enum Attempt {
    Ended(Ended),
    /// The job is another's by now.
    Lost,
    /// No run was started.
    Refused(Meaning, i32, String),
}

impl Worker<'_> {
    /// One run.
    pub(super) fn attempt(&self, job: &Job, lease: &Lease) -> Result<Attempt, WorkError> {
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
        credentials::remove(&mut command);
        let ended = child::run(command, log, &guard).map_err(FileError::read(&self.tools.program))?;
        Ok(if lease.is_lost() {
            Attempt::Lost
        } else {
            Attempt::Ended(ended)
        })
    }

    /// What is said of a folder that is not ours where a result should go.
    pub(super) fn in_the_way(&self, job: &Job) -> String {
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
                    CANNOT_READ,
                    format!("cannot read {}: {e}", job.input),
                ));
            }
            Ok(_) => {}
        }
        match (self.tools.hash)(path) {
            Err(reason) => Some(Attempt::Refused(Meaning::GiveBack, CANNOT_READ, reason)),
            Ok(found) if job.blake3 != found => {
                poison(65, format!("{} changed since it was planned; plan again", job.input))
            }
            Ok(_) => None,
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
    let begun = fs::read(work.join(RUN_FILE)).is_ok_and(|text| is_record(&text));
    if !begun {
        fs::remove_dir_all(work)?;
    }
    Ok(true)
}

fn is_record(text: &[u8]) -> bool {
    serde_json::from_slice::<serde_json::Value>(text).is_ok_and(|v| v["format"].is_string())
}
