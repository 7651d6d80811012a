//! `minute4d batch run`: one job.

use crate::args::{BatchRun, Common};
use crate::failure::Failure;
use crate::output::{Output, duration};
use minute4d::batch::{BatchError, JobEnd, Manifest, Outcome, Tools, Watch, index_of_environment, run_job};
use minute4d::{Category, Progress};
use serde_json::json;
use sysinfo::System;

pub fn run(args: &BatchRun, common: &Common, output: &Output) -> Result<(), Failure> {
    output.stop().of_an_engine();
    let manifest = Manifest::read(&args.manifest).map_err(elsewhere)?;
    let index = match args.index {
        Some(index) => Some(index),
        None => index_of_environment(|name| std::env::var(name).ok())?,
    };
    let Some(index) = index else {
        let last = manifest.jobs.len().saturating_sub(1);
        return Err(Failure::usage(&format!(
            "which job? --index takes 0 to {last}; a scheduler starts one process for each (docs/batch.md)"
        )));
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
    let end = run_job(&manifest, index, args.retry_failed, &tools, &Voice(output)).map_err(elsewhere)?;
    let id = &manifest.jobs[index].id;
    let text = words(id, &end);
    output.result(
        &text,
        json!({"index": index, "id": id, "outcome": end.outcome, "seconds": end.seconds, "reason": end.reason}),
    );
    let code = match end.outcome {
        Outcome::Done => return Ok(()),
        Outcome::Failed => Category::BadInput.exit_code(),
        // Ctrl-C keeps its own code: whoever pressed it wants no scheduler to begin anew.
        Outcome::Retryable => {
            let pressed = output
                .stop()
                .code()
                .filter(|&code| code == Category::Stopped.exit_code());
            pressed.unwrap_or(Category::TryAgain.exit_code())
        }
    };
    Err(Failure { code, reason: text })
}

/// What cannot be read or written here may be so on another machine, or later; what is wrong with a manifest is no fault of a clip.
fn elsewhere(error: BatchError) -> Failure {
    let category = match &error {
        BatchError::Read { .. } | BatchError::Write { .. } => Category::TryAgain,
        BatchError::Manifest { .. } => Category::BadSettings,
        _ => return error.into(),
    };
    Failure {
        code: category.exit_code(),
        ..error.into()
    }
}

fn words(id: &str, end: &JobEnd) -> String {
    match (end.outcome, end.seconds) {
        (Outcome::Done, Some(seconds)) => format!("{id}: done in {}", duration(seconds)),
        (Outcome::Done, None) => format!("{id}: done before"),
        (Outcome::Failed, Some(_)) => format!("{id} failed permanently: {}", end.reason),
        (Outcome::Failed, None) => format!(
            "{id} failed permanently before, and is not run again without --retry-failed: {}",
            end.reason
        ),
        (Outcome::Retryable, _) => format!("{id} is to be tried again: {}", end.reason),
    }
}

/// The run talks through the program's voice.
struct Voice<'a>(&'a Output);

impl Watch for Voice<'_> {
    fn stop(&self) -> bool {
        self.0.cancelled()
    }

    fn progress(&self, phase: &str, done: usize, total: usize, note: &str) {
        self.0.update(phase, done, total, note);
    }
}
