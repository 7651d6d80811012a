//! `minute4d batch run`: runs one job of a manifest.

use super::hash;
use crate::cli::Common;
use crate::commands::program;
use crate::failure::Failure;
use crate::output::{Output, duration};
use clap::Args;
use minute4d::batch::{BatchError, JobEnd, Manifest, Outcome, Tools, Watch, index_of_environment, run_job};
use minute4d::{Category, Progress};
use serde_json::json;
use std::path::PathBuf;
use sysinfo::System;

/// `minute4d batch run`
#[derive(Debug, Args)]
pub struct BatchRun {
    /// The manifest
    #[arg(long, value_name = "FILE")]
    pub manifest: PathBuf,
    /// Index of the job, counted from 0 [default: SLURM_ARRAY_TASK_ID or JOB_COMPLETION_INDEX, whichever is set first]
    #[arg(long, value_name = "N")]
    pub index: Option<usize>,
    /// Run the job again even if it failed permanently
    #[arg(long)]
    pub retry_failed: bool,
}

pub fn run(args: &BatchRun, common: &Common, output: &Output) -> Result<(), Failure> {
    output.stop().of_an_engine();
    let manifest = Manifest::read(&args.manifest).map_err(batch_failure)?;
    let index = match args.index {
        Some(index) => Some(index),
        None => index_of_environment(|name| std::env::var(name).ok())?,
    };
    let Some(index) = index else {
        let last = manifest.jobs.len().saturating_sub(1);
        return Err(Failure::usage(&format!(
            "no job index: pass --index from 0 to {last}; a scheduler starts one process per job (docs/batch.md)"
        )));
    };
    let tools = Tools {
        program: program()?,
        arguments: common.threads.map_or_else(Vec::new, |n| vec!["--threads".to_owned(), n.to_string()]),
        hash: &hash,
        host: System::host_name().unwrap_or_else(|_| "unknown".to_owned()),
    };
    let end = run_job(&manifest, index, args.retry_failed, &tools, &JobProgress(output)).map_err(batch_failure)?;
    let id = &manifest.jobs[index].id;
    let text = describe(id, &end);
    output.result(
        &text,
        json!({"index": index, "id": id, "outcome": end.outcome, "seconds": end.seconds, "reason": end.reason}),
    );
    let code = match end.outcome {
        Outcome::Done => return Ok(()),
        Outcome::Failed => Category::BadInput.exit_code(),
        // Ctrl-C keeps its own code, so that the scheduler does not run the job again.
        Outcome::Retryable => {
            let pressed = output.stop().code().filter(|&code| code == Category::Stopped.exit_code());
            pressed.unwrap_or(Category::TryAgain.exit_code())
        }
    };
    Err(Failure { code, reason: text })
}

/// Maps an error outside the clip to an exit code: files that cannot be read or written may work later or on another machine; a bad manifest is bad settings.
fn batch_failure(error: BatchError) -> Failure {
    let category = match &error {
        BatchError::Read { .. } | BatchError::Write { .. } => Category::TryAgain,
        BatchError::Manifest { .. } => Category::BadSettings,
        _ => return error.into(),
    };
    Failure { code: category.exit_code(), ..error.into() }
}

fn describe(id: &str, end: &JobEnd) -> String {
    match (end.outcome, end.seconds) {
        (Outcome::Done, Some(seconds)) => format!("{id}: done in {}", duration(seconds)),
        (Outcome::Done, None) => format!("{id}: already done"),
        (Outcome::Failed, Some(_)) => format!("{id} failed permanently: {}", end.reason),
        (Outcome::Failed, None) => {
            format!("{id} failed permanently before and is not run again without --retry-failed: {}", end.reason)
        }
        (Outcome::Retryable, _) => format!("{id} should be retried: {}", end.reason),
    }
}

/// Forwards the progress of a job to the program's output.
struct JobProgress<'a>(&'a Output);

impl Watch for JobProgress<'_> {
    fn stop(&self) -> bool {
        self.0.cancelled()
    }

    fn progress(&self, phase: &str, done: usize, total: usize, note: &str) {
        self.0.update(phase, done, total, note);
    }
}
