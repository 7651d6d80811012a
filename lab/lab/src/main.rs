//! The `minute4d-lab` program: measures minute4d against published tables, ground truth and itself
//! without parts of the method.
//!
//! ```text
//! reproduce   data sets -> import, split, train, score -> the tables of papers
//! ablate      a clip with and without each part of the method
//! explain     which error of a capture costs what in views
//! bench       milliseconds per kernel, next to the limits of the machine
//! results     the tables of docs/results.md
//! ```

mod ablate;
mod bench;
mod bench_command;
mod commands;
mod explain;
mod program;
mod reproduce;
mod results;

use bench_command::Bench;
use clap::{Parser, Subcommand};
use commands::{Ablate, EvalGeometry, Reproduce};
use minute4d::Category;
use minute4d_cli::failure::Failure;
use minute4d_cli::output::Output;
use minute4d_cli::{Cli, Common, Program, start};
use program::MINUTE4D;
use results::Results;
use std::ffi::OsString;
use std::path::Path;
use std::process::ExitCode;

/// Measures minute4d against published tables, ground truth and itself without parts of the method.
///
/// `minute4d-lab minute4d ARGUMENTS` is the program itself. The result goes to stdout, progress and
/// messages to stderr.
#[derive(Debug, Parser)]
#[command(name = "minute4d-lab", version, max_term_width = 100)]
struct Lab {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Reproduce published tables from a data set: import, split, train and score every scene
    Reproduce(Reproduce),
    /// Measure the contribution of segmentation, tracking and density control on a clip
    Ablate(Ablate),
    /// Compare the cameras, depth and masks of a capture with ground truth
    EvalGeometry(EvalGeometry),
    /// Benchmark the kernels on this machine
    Bench(Bench),
    /// Measure the tables of docs/results.md on rendered scenes and clips, and write them there;
    /// takes hours
    Results(Results),
}

impl Program for Lab {
    fn common(&self) -> &Common {
        &self.common
    }

    fn run(&self, output: &Output) -> Result<(), Failure> {
        match &self.command {
            Command::Reproduce(args) => commands::run(args, output),
            Command::Ablate(args) => commands::ablate(args, output),
            Command::EvalGeometry(args) => commands::run_geometry(args, output),
            Command::Bench(args) => bench_command::run(args, &self.common, output),
            Command::Results(args) => results(args),
        }
    }
}

/// Measures the tables of the repository that this program was built from.
fn results(wanted: &Results) -> Result<(), Failure> {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = here.ancestors().nth(2).unwrap_or(here);
    results::run(root, wanted).map_err(|error| Failure {
        code: Category::BadInput.exit_code(),
        reason: format!("{error:#}"),
    })
}

fn main() -> ExitCode {
    let mut args: Vec<OsString> = std::env::args_os().collect();
    if args.get(1).is_some_and(|arg| arg == MINUTE4D) {
        args.remove(1);
        return start::<Cli>(args);
    }
    start::<Lab>(args)
}

#[cfg(test)]
mod tests {
    use super::Lab;
    use clap::{CommandFactory, Parser};

    #[test]
    fn arguments_are_checked_when_parsed() {
        Lab::command().debug_assert();
        let parsed = |line: &str| {
            Lab::try_parse_from(std::iter::once("minute4d-lab").chain(line.split(' '))).is_ok()
        };
        for wrong in [
            "reproduce kitti --data a -o b",
            "bench --size 480",
            "bench --scene 5d",
        ] {
            assert!(!parsed(wrong), "{wrong}");
        }
        assert!(parsed(
            "bench --splats 10,20 --size 480x360,96x72 --scene static,4d --quick"
        ));
        assert!(parsed(
            "ablate a -o b --data c --rows no-seg,no-track --iterations 100"
        ));
        assert!(parsed(
            "reproduce dycheck --data a -o b --protocols instant4d,rodygs --scenes apple,spin --preset draft"
        ));
    }
}
