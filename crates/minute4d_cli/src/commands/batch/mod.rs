//! `minute4d batch`: many clips on many machines.

mod plan;
mod run;
mod status;
mod submit;

use crate::args::{Batch, BatchAction, Common};
use crate::failure::{Failure, chain};
use crate::output::Output;
use minute4d::Category;
use minute4d::batch::slurm::SubmitError;
use minute4d::batch::{FileError, ManifestError, PlanError, WorkError};
use minute4d::io::ErrorKind;
use std::error::Error;
use std::path::Path;

pub fn run(args: &Batch, common: &Common, output: &Output) -> Result<(), Failure> {
    match &args.action {
        BatchAction::Plan(args) => plan::run(args, output),
        BatchAction::Run(args) => run::run(args, common, output),
        BatchAction::Submit(args) => submit::run(args, output),
        BatchAction::Status(args) => status::run(args, output),
    }
}

/// BLAKE3 of an input, as the record of its run has it.
fn hash(path: &Path) -> Result<String, String> {
    minute4d::hash_of_path(path).map_err(|e| chain(&e))
}

fn failure(kind: ErrorKind, error: &dyn Error) -> Failure {
    Failure {
        code: Category::from(kind).exit_code(),
        reason: chain(error),
    }
}

impl From<FileError> for Failure {
    fn from(error: FileError) -> Self {
        failure(error.kind(), &error)
    }
}

impl From<ManifestError> for Failure {
    fn from(error: ManifestError) -> Self {
        failure(error.kind(), &error)
    }
}

impl From<PlanError> for Failure {
    fn from(error: PlanError) -> Self {
        failure(error.kind(), &error)
    }
}

impl From<WorkError> for Failure {
    fn from(error: WorkError) -> Self {
        failure(error.kind(), &error)
    }
}

impl From<SubmitError> for Failure {
    fn from(error: SubmitError) -> Self {
        failure(error.kind(), &error)
    }
}
