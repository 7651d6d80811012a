//! `minute4d weights` in a build without networks: accepts any arguments, so that the error can say how to build with them.

use crate::failure::Failure;
use crate::output::Output;
use clap::Args;
use minute4d::{BUILD_FULL, Category};

/// `minute4d weights`
#[derive(Debug, Args)]
pub struct Weights {
    /// The arguments, which are ignored.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    _rest: Vec<String>,
}

pub fn run(_: &Weights, _: &Output) -> Result<(), Failure> {
    Err(Failure {
        code: Category::NoDevice.exit_code(),
        reason: format!(
            "this program was built without networks, so it uses no weights; `{BUILD_FULL}` builds it with networks"
        ),
    })
}
