//! The `minute4d` program: commands, messages, exit codes; and runs, which keep what the library
//! computes in a folder.
//!
//! [`run`](mod@run) has the stages on disk with their records, checkpoints and order;
//! `minute4d-lab` builds on it.

mod advice;
pub mod batch;
mod cli;
mod commands;
pub mod failure;
mod gallery;
mod memory;
pub mod options;
pub mod output;
mod program;
mod report_file;
pub mod run;
pub mod view;

/// The command that builds the program with GPU support and networks, for messages about missing
/// features.
pub const BUILD_FULL: &str = "cargo build --release -p minute4d_cli --features full";

pub use cli::Cli;
pub use commands::doctor::processor;
pub use options::Common;
pub use program::{Program, program, start};
