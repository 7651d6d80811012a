//! `minute4d import`

use super::export::format;
use clap::Args;
use minute4d::export::Format;
use std::path::PathBuf;

/// `minute4d import`
#[derive(Debug, Args)]
pub struct Import {
    /// A .4dgs, .splatv, .spz or .glb file, or a PLY file of splats as 3DGS writes it
    pub file: PathBuf,
    /// Folder for the scene, as of a run
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// The format [default: what the name ends in]
    #[arg(long, value_name = "FORMAT", value_parser = format)]
    pub format: Option<Format>,
    /// Replace what an earlier run left in the folder; other files in it stay
    #[arg(long)]
    pub force: bool,
}
