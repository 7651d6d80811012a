//! One file per command, which turns arguments into a call of the library and prints the result.

mod ablate;
mod batch;
mod bench;
mod doctor;
mod enhance;
mod eval;
mod eval_geometry;
mod export;
mod geometry;
mod import;
mod inspect;
mod render;
mod reproduce;
mod run;
mod settings;
mod split;
mod train;
mod view;
#[cfg(feature = "nets")]
mod weights;

use crate::args::{Cli, Command};
use crate::failure::Failure;
use crate::output::Output;

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
        Command::EvalGeometry(args) => eval_geometry::run(args, output),
        Command::Batch(args) => batch::run(args, &cli.common, output),
        Command::Inspect(args) => inspect::run(args, output),
        Command::Doctor => doctor::run(output),
        Command::Bench(args) => bench::run(args, &cli.common, output),
        #[cfg(feature = "nets")]
        Command::Weights(args) => weights::run(args, output),
        #[cfg(not(feature = "nets"))]
        Command::Weights(_) => Err(Failure {
            code: minute4d::Category::NoDevice.exit_code(),
            reason: format!(
                "this program was built without networks, so it uses no weights; `{}` builds it with networks",
                minute4d::BUILD_FULL
            ),
        }),
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
