//! One job: its lease, its attempts, what is recorded of it.

use super::attempt::{Attempt, CANNOT_READ, CANNOT_WRITE, NO_DEVICE};
use super::{JobEnd, Worker};
use crate::error::{FileError, WorkError};
use crate::lease::{self, Lease, Taken};
use crate::manifest::Job;
use crate::publish::{Present, Published, present, publish};
use crate::record::{JobRecord, Verdict, now_s};
use crate::verdict::{Meaning, meaning};
use std::fs;
use std::time::Instant;

/// Workers that may vanish over a job, for each attempt that may crash. Machines go away for reasons of their own.
const VANISHED_AN_ATTEMPT: u32 = 3;

impl Worker<'_> {
    /// Does a job, unless it is done; `None` where another has it.
    pub(super) fn job(&self, job: &Job) -> Result<Option<JobEnd>, WorkError> {
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
        let record = JobRecord::read(&self.layout.state(&job.id), key)?;
        if present(&self.layout.result(&job.id), key)? == Present::Same {
            return Ok(Some(JobEnd::Done { seconds: None }));
        }
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
        if vanished {
            // At once: this worker may vanish as well.
            record.vanished += 1;
            record.verdict = Verdict::Interrupted;
            record.reason = "its worker vanished".to_owned();
            record.write(&path)?;
        }
        loop {
            let start = Instant::now();
            let limit = self.options.attempts.max(1);
            let attempt = if record.vanished >= limit.saturating_mul(VANISHED_AN_ATTEMPT) {
                let said = format!("{} workers vanished while they were at it", record.vanished);
                Attempt::Refused(Meaning::Poison, 1, said)
            } else {
                self.attempt(job, lease).or_else(given_back)?
            };
            let (how, mut code, mut reason) = match attempt {
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
                match publish(&self.layout, &job.id, key, &self.tools.host, lease) {
                    Ok(Published::Yes) => {}
                    Ok(Published::Lost) => return Ok(None),
                    Err(error) => {
                        (verdict, code) = (Verdict::Interrupted, Some(exit_code(&error)));
                        reason = format!("the result was not published: {error}");
                    }
                    Ok(Published::Bad(said)) => {
                        (verdict, reason) = (Verdict::Failed, format!("the result was not published: {said}"));
                    }
                    Ok(Published::Foreign) => (verdict, reason) = (Verdict::Poison, self.in_the_way(job)),
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
                    let seconds = Some(record.seconds);
                    return Ok(Some(JobEnd::Done { seconds }));
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
}

/// What this machine cannot write or read, a full disk above all, is no fault of the clip: another may.
fn given_back(error: WorkError) -> Result<Attempt, WorkError> {
    match error {
        WorkError::File(error) => {
            let reason = error.to_string();
            Ok(Attempt::Refused(Meaning::GiveBack, exit_code(&error), reason))
        }
        error => Err(error),
    }
}

/// The code that a run ends with for the same reason.
fn exit_code(error: &FileError) -> i32 {
    match error {
        FileError::Read { .. } => CANNOT_READ,
        FileError::Write { .. } => CANNOT_WRITE,
    }
}
