//! `minute4d batch run`: a worker.

use crate::args::{BatchRun, Common};
use crate::failure::Failure;
use crate::output::{Output, duration};
use minute4d::Progress;
use minute4d::batch::{
    JobEnd, Listener, Manifest, Share, Summary, Tools, WorkError, WorkOptions, index_of_environment, work,
};
use serde_json::json;
use std::time::Duration;
use sysinfo::System;

/// Something is left to be tried again.
const AGAIN: u8 = 75;
/// The one job of this worker will never work.
const POISON: u8 = 65;

pub fn run(args: &BatchRun, common: &Common, output: &Output) -> Result<(), Failure> {
    output.stop().of_an_engine();
    let manifest = Manifest::read(&args.manifest)?;
    let index = match args.index {
        Some(index) => Some(index),
        None => index_of_environment(|name| std::env::var(name).ok())?,
    };
    let options = WorkOptions {
        share: Share::new(index, args.stride.map(|n| n as usize)),
        scratch: args
            .scratch
            .as_deref()
            .map(std::path::absolute)
            .transpose()
            .map_err(|source| minute4d::Error::Read {
                path: args.scratch.clone().unwrap_or_default(),
                source,
            })?,
        lease: Duration::from_secs(args.lease_seconds.into()),
        attempts: args.attempts,
        retry_failed: args.retry_failed,
        wait: !args.no_wait,
    };
    let program = std::env::current_exe().map_err(|e| minute4d::Error::Internal {
        what: format!("this program does not know where it is: {e}"),
    })?;
    let tools = Tools {
        program,
        arguments: common
            .threads
            .map_or_else(Vec::new, |n| vec!["--threads".to_owned(), n.to_string()]),
        hash: &super::hash,
        host: System::host_name().unwrap_or_else(|_| "unknown".to_owned()),
    };
    let summary = work(&manifest, &options, &tools, &Voice(output)).map_err(elsewhere)?;
    let text = words(&summary);
    output.result(
        &text,
        json!({
            "jobs": summary.jobs, "done": summary.done, "done_before": summary.done_before, "poison": summary.poison,
            "again": summary.again,
            "reasons": summary.reasons.iter().map(|(id, why)| json!({"id": id, "reason": why})).collect::<Vec<_>>(),
        }),
    );
    ended(&summary, index.is_some(), output)
}

/// What a machine cannot write or read may be better on another, or later.
fn elsewhere(error: WorkError) -> Failure {
    let code = matches!(error, WorkError::File(_)).then_some(AGAIN);
    let failure = Failure::from(error);
    Failure {
        code: code.unwrap_or(failure.code),
        ..failure
    }
}

/// The exit code of a worker: what should be tried again comes before what never will work.
fn ended(summary: &Summary, indexed: bool, output: &Output) -> Result<(), Failure> {
    let first = |what: &str| {
        let (id, why) = summary.reasons.first().cloned().unwrap_or_default();
        format!("{what}; {id}: {why}")
    };
    if summary.again > 0 {
        // Ctrl-C keeps its own code: whoever pressed it wants no engine to begin anew.
        let code = output.stop().code().filter(|&code| code == 130).unwrap_or(AGAIN);
        let reason = first(&format!(
            "{} of {} jobs should be tried again",
            summary.again, summary.jobs
        ));
        return Err(Failure { code, reason });
    }
    if summary.poison > 0 && indexed && summary.jobs == 1 {
        return Err(Failure {
            code: POISON,
            reason: first("this job was given up"),
        });
    }
    Ok(())
}

fn words(summary: &Summary) -> String {
    let mut text = format!(
        "{} jobs: {} done, {} done before, {} given up, {} to be tried again\n",
        summary.jobs, summary.done, summary.done_before, summary.poison, summary.again
    );
    for (id, why) in &summary.reasons {
        text += &format!("{id}: {why}\n");
    }
    text
}

/// The worker talks through the program's voice.
struct Voice<'a>(&'a Output);

impl Listener for Voice<'_> {
    fn stop(&self) -> bool {
        self.0.cancelled()
    }

    fn progress(&self, id: &str, phase: &str, done: usize, total: usize, note: &str) {
        self.0.update(&format!("{id}: {phase}"), done, total, note);
    }

    fn ended(&self, id: &str, end: &JobEnd) {
        match end {
            JobEnd::Done { seconds: Some(s) } => self.0.note(&format!("{id}: done in {}", duration(*s))),
            JobEnd::Done { seconds: None } => self.0.note(&format!("{id}: done before")),
            JobEnd::Poison { reason } => self.0.warn(&format!("{id} is given up: {reason}")),
            JobEnd::Again { reason, .. } => self.0.warn(&format!("{id} is to be tried again: {reason}")),
        }
    }
}
