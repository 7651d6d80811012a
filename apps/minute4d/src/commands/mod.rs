//! The commands: its options, the call of the library, and the result that is printed.

pub mod batch;
pub mod bench;
pub mod doctor;
pub mod eval;
pub mod geometry;
pub mod interchange;
pub mod render;
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

use crate::cli::{Cli, Command, Common};
use crate::failure::Failure;
use crate::output::Output;
use crate::{Program, program};

impl Program for Cli {
    fn common(&self) -> &Common {
        &self.common
    }

    fn run(&self, output: &Output) -> Result<(), Failure> {
        match &self.command {
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
            Command::Batch(args) => batch::run(args, &self.common, output),
            Command::Doctor => doctor::run(output),
            Command::Bench(args) => bench::run(args, &self.common, output),
            Command::Weights(args) => weights::run(args, output),
        }
    }
}
