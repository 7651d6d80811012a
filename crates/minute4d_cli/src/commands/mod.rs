//! One file per command: its options, the call of the library, and the result that is printed.

pub mod ablate;
pub mod batch;
pub mod bench;
pub mod doctor;
pub mod enhance;
pub mod eval;
pub mod export;
pub mod geometry;
pub mod import;
pub mod inspect;
pub mod render;
pub mod reproduce;
pub mod run;
pub mod split;
pub mod train;
pub mod view;
#[cfg_attr(not(feature = "nets"), path = "no_weights.rs")]
pub mod weights;

use crate::cli::{Cli, Command};
use crate::failure::Failure;
use crate::output::Output;
use std::path::PathBuf;

/// Runs the command with the requested number of threads.
///
/// # Errors
///
/// [`Failure`] with the exit code and the message for the user.
pub fn run(cli: &Cli, output: &Output) -> Result<(), Failure> {
    let threads = cli.common.threads.map(usize::from);
    let outcome = minute4d::with_threads(threads, || match &cli.command {
        Command::Run(args) => run::run(args, output),
        Command::Geometry(args) => geometry::run(args, output),
        Command::Enhance(args) => enhance::run(args, output),
        Command::Train(args) => train::run(args, output),
        Command::Render(args) => render::run(args, output),
        Command::Export(args) => export::run(args, output),
        Command::Import(args) => import::run(args, output),
        Command::View(args) => view::run(args, output),
        Command::Eval(args) => eval::run(args, output),
        Command::Split(args) => split::run(args, output),
        Command::Reproduce(args) => reproduce::run(args, output),
        Command::Ablate(args) => ablate::run(args, output),
        Command::EvalGeometry(args) => eval::run_geometry(args, output),
        Command::Batch(args) => batch::run(args, &cli.common, output),
        Command::Inspect(args) => inspect::run(args, output),
        Command::Doctor => doctor::run(output),
        Command::Bench(args) => bench::run(args, &cli.common, output),
        Command::Weights(args) => weights::run(args, output),
    })
    .map_err(Failure::from)?;
    outcome.map_err(|failure| stopped(failure, output))
}

/// Gives a command that ended because of a signal the exit code of that signal.
fn stopped(failure: Failure, output: &Output) -> Failure {
    match output.stop().code() {
        Some(code) if failure.code == minute4d::Category::Stopped.exit_code() => Failure { code, ..failure },
        _ => failure,
    }
}

/// Returns the path of this program, which runs parts of some commands in processes of their own.
fn program() -> Result<PathBuf, Failure> {
    std::env::current_exe()
        .map_err(|e| minute4d::Error::Internal { what: format!("the path of this program is unknown: {e}") }.into())
}
