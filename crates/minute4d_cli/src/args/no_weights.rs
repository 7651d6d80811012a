//! `minute4d weights` in a program without networks: any arguments, to say how to build one with them.

use clap::Args;

/// `minute4d weights`
#[derive(Debug, Args)]
pub struct Weights {
    /// What would be done with them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    _rest: Vec<String>,
}
