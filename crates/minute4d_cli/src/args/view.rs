//! `minute4d view`, and the viewer page of a run.

use clap::Args;
use std::path::PathBuf;

/// `minute4d view`
#[derive(Debug, Args)]
pub struct View {
    /// The folder of a run (finished, stopped or still training), or a scene file
    pub scene: PathBuf,
    /// Port of 127.0.0.1 to listen on [default: any free port]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub port: Option<u16>,
    /// Print the address without opening a browser
    #[arg(long)]
    pub no_open: bool,
}

/// The viewer page of a run.
#[derive(Debug, Args)]
pub struct PageArgs {
    /// Do not write viewer.html
    #[arg(long)]
    pub no_viewer: bool,
    /// Show the scene in the browser during training; on a terminal the page stays until Ctrl-C
    #[arg(long)]
    pub view: bool,
    /// Port of 127.0.0.1 for --view [default: any free port]
    #[arg(long, value_name = "N", requires = "view", value_parser = clap::value_parser!(u16).range(1..))]
    pub port: Option<u16>,
    /// With --view: print the address without opening a browser
    #[arg(long, requires = "view")]
    pub no_open: bool,
}
