//! `minute4d weights` in a build without networks: accepts any arguments, so that the error can say how to build with them.

use clap::Args;

/// `minute4d weights`
#[derive(Debug, Args)]
pub struct Weights {
    /// The arguments, which are ignored.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    _rest: Vec<String>,
}
