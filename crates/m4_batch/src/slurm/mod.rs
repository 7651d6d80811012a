//! A batch as an array of Slurm jobs.

mod script;
mod submit;

pub use script::{Options, Script};
pub use submit::{SubmitError, largest_array, submit};
