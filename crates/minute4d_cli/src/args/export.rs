//! `minute4d export`

use super::ReachArgs;
use super::values::rate;
use clap::{Args, ValueEnum};
use minute4d::export::Format;
use std::path::PathBuf;

/// `minute4d export`
#[derive(Debug, Args)]
pub struct Export {
    /// The folder of a run, or a scene file; for colmap and nerfstudio a capture, too
    pub scene: PathBuf,
    /// The format [default: what --out ends in, or 4dgs]; 4dgs, splatv: the whole clip; ply, spz, gltf: one
    /// instant; ply-sequence: one a frame; colmap, nerfstudio: cameras, of a capture with pictures, masks, points (and depth); mp4: a
    /// video along the cameras of the source
    #[arg(long, value_name = "FORMAT", value_parser = format)]
    pub format: Option<Format>,
    /// The file, or the folder of a sequence [default: scene.4dgs and the like, beside the scene]
    #[arg(long, short, value_name = "PATH")]
    pub out: Option<PathBuf>,
    /// The instant of a format that has one: a frame, or seconds with an `s` behind, as in 1.5s [default: the middle]
    #[arg(long, value_name = "T")]
    pub time: Option<String>,
    /// Files or pictures a second of a format that has many [default: the frames of the source]
    #[arg(long, value_name = "FPS", value_parser = rate)]
    pub fps: Option<f64>,
    /// How finely a .4dgs file is written
    #[arg(long, value_enum, value_name = "P", default_value = "normal")]
    pub precision: PrecisionArg,
    /// Replace a file that is already there
    #[arg(long)]
    pub force: bool,
    /// Do not read the file back, render it and compare it with the scene, as is done with 4dgs, ply and ply-sequence
    #[arg(long)]
    pub no_compare: bool,
    /// Write the opacities as they were trained, for players with a Mip filter and for `import`; else what the filter does to
    /// them is baked in, as the cameras of the source see it
    #[arg(long)]
    pub keep_mip: bool,
    /// Which files it may name.
    #[command(flatten)]
    pub reach: ReachArgs,
}

/// How finely a `.4dgs` file is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PrecisionArg {
    /// Larger, closer
    Fine,
    /// The default of the format
    Normal,
    /// Smaller
    Coarse,
}

/// The name of a format.
pub fn format(text: &str) -> Result<Format, String> {
    text.parse().map_err(|e: minute4d::export::ExportError| e.to_string())
}
