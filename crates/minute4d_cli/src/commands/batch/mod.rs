//! `minute4d batch`: processes many clips as jobs of a scheduler.

mod plan;
mod run;
mod status;
mod submit;

use crate::args::{Batch, BatchAction, Common};
use crate::failure::{Failure, chain};
use crate::output::Output;
use minute4d::Category;
use minute4d::batch::BatchError;
use std::path::Path;

pub fn run(args: &Batch, common: &Common, output: &Output) -> Result<(), Failure> {
    match &args.action {
        BatchAction::Plan(args) => plan::run(args, output),
        BatchAction::Run(args) => run::run(args, common, output),
        BatchAction::Submit(args) => submit::run(args, output),
        BatchAction::Status(args) => status::run(args, output),
    }
}

/// Returns the BLAKE3 hash of an input, as recorded in its run.
fn hash(path: &Path) -> Result<String, String> {
    minute4d::hash_of_path(path).map_err(|e| chain(&e))
}

impl From<BatchError> for Failure {
    fn from(error: BatchError) -> Self {
        Self {
            code: Category::from(error.kind()).exit_code(),
            reason: chain(&error),
        }
    }
}
