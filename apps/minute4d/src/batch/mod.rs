//! Batches of clips: planning, running one job, and reporting the results.
//!
//! A [`Manifest`] lists the clips and holds the settings. A scheduler starts one process a job
//! ([`run_job`]): it has a child process make the scene in a working folder, and publishes the
//! whole result by one rename. Which machine does what, and what is started again, is the
//! scheduler's business; [`slurm`] submits to one. All that is known afterwards ([`Report`]) is
//! read from the results.

mod child;
mod job;
mod layout;
mod manifest;
mod plan;
mod publish;
mod report;
pub mod slurm;

pub use job::{INDEX_VARIABLES, JobEnd, Tools, index_of_environment, run_job};
pub use layout::{JobRecord, Layout, Outcome, RESULT_FILE};
pub use manifest::{Arguments, FORMAT, Job, Manifest, VERSION};
pub use plan::plan;
pub use report::{ClipReport, ClipState, Report, page};

use minute4d::{Category, Refusal};
use std::path::Path;

/// The refusal of a folder of results that holds something else.
fn not_ours(path: &Path) -> Refusal {
    let message = format!(
        "{} exists and was not created by `minute4d batch`; choose another folder with --out, or move it away",
        path.display()
    );
    Refusal::new(Category::CannotWrite, message)
}
