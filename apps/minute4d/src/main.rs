//! The `minute4d` program.

use minute4d_cli::Cli;
use std::process::ExitCode;

fn main() -> ExitCode {
    minute4d_cli::start::<Cli>(std::env::args_os().collect())
}
