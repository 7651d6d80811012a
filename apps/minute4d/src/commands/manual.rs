//! `minute4d manual`: man pages and completions of shells, from the definition of the command line.

use crate::failure::Failure;
use crate::output::Output;
use clap::{Args, CommandFactory};
use clap_complete::Shell;
use minute4d::Error;
use serde_json::json;
use std::fs;
use std::path::PathBuf;

/// Where to.
#[derive(Debug, Args)]
pub struct Manual {
    /// Folder for the man pages (man1) and the completions; existing files of the same names are
    /// replaced
    pub out: PathBuf,
}

/// Writes them for the command line `C`.
pub fn run<C: CommandFactory>(args: &Manual, output: &Output) -> Result<(), Failure> {
    let pages = args.out.join("man1");
    let failed = Error::write(&args.out);
    fs::create_dir_all(&pages).map_err(failed)?;
    clap_mangen::generate_to(C::command(), &pages).map_err(failed)?;
    for shell in [Shell::Bash, Shell::Zsh, Shell::Fish, Shell::PowerShell] {
        clap_complete::generate_to(shell, &mut C::command(), "minute4d", &args.out)
            .map_err(failed)?;
    }
    Ok(output.result(
        format!("written to {}\n", args.out.display()),
        &json!({"path": args.out}),
    )?)
}
