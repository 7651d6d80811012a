//! A batch as an array of Slurm jobs.

mod script;
mod submit;

pub use script::Script;
pub use submit::{largest_array, submit};
