//! The commands: its options, the call of the library, and the result that is printed.

pub mod batch;
pub mod bench;
pub mod doctor;
pub mod eval;
pub mod geometry;
pub mod interchange;
pub mod render;
pub mod reproduce;
pub mod run;
pub mod view;
#[cfg(feature = "nets")]
pub mod weights;
/// In a build without networks the command accepts any arguments, so that the error can say how to build with them.
#[cfg(not(feature = "nets"))]
pub mod weights {
    use crate::failure::Failure;
    use minute4d::{BUILD_FULL, Category};

    #[derive(Debug, clap::Args)]
    pub struct Weights {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        _rest: Vec<String>,
    }

    pub fn run(_: &Weights, _: &crate::output::Output) -> Result<(), Failure> {
        let reason = format!(
            "this program was built without networks, so it uses no weights; `{BUILD_FULL}` builds it with networks"
        );
        Err(Failure { code: Category::NoDevice.exit_code(), reason })
    }
}

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
        Command::Enhance(args) => geometry::enhance(args, output),
        Command::Train(args) => run::train(args, output),
        Command::Render(args) => render::run(args, output),
        Command::Export(args) => interchange::export(args, output),
        Command::Import(args) => interchange::import(args, output),
        Command::View(args) => view::run(args, output),
        Command::Eval(args) => eval::run(args, output),
        Command::Split(args) => eval::split(args, output),
        Command::Reproduce(args) => reproduce::run(args, output),
        Command::Ablate(args) => reproduce::ablate(args, output),
        Command::EvalGeometry(args) => eval::run_geometry(args, output),
        Command::Batch(args) => batch::run(args, &cli.common, output),
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
