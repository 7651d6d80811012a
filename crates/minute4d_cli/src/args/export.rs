//! `minute4d export`

use super::ReachArgs;
use super::values::rate;
use clap::{Args, ValueEnum};
use minute4d::export::Format;
use std::path::PathBuf;

/// `minute4d export`
#[derive(Debug, Args)]
pub struct Export {
    /// The folder of a run or a scene file; for colmap and nerfstudio a capture
    pub scene: PathBuf,
    /// Output format [default: by the extension of --out, or 4dgs]. 4dgs, splatv: the whole clip; ply, spz, gltf: one
    /// instant; ply-sequence: one file per frame; colmap, nerfstudio: cameras, images, masks and points of a capture (and depth);
    /// mp4: a video rendered from the source cameras
    #[arg(long, value_name = "FORMAT", value_parser = format)]
    pub format: Option<Format>,
    /// Output file, or folder for a sequence [default: scene.EXTENSION next to the scene]
    #[arg(long, short, value_name = "PATH")]
    pub out: Option<PathBuf>,
    /// Instant for formats that hold one: a frame number, or seconds with the suffix `s`, as in 1.5s [default: the middle]
    #[arg(long, value_name = "T")]
    pub time: Option<String>,
    /// Files or frames per second for sequences and videos [default: the rate of the source]
    #[arg(long, value_name = "FPS", value_parser = rate)]
    pub fps: Option<f64>,
    /// Quantisation of a .4dgs file
    #[arg(long, value_enum, value_name = "P", default_value = "normal")]
    pub precision: PrecisionArg,
    /// Replace an existing file
    #[arg(long)]
    pub force: bool,
    /// Skip the check that reads 4dgs, ply and ply-sequence files back and compares their renderings with the scene
    #[arg(long)]
    pub no_compare: bool,
    /// Write opacities as trained, for viewers with a Mip filter and for `import`; without it, the effect of the filter at the
    /// source cameras is baked into the opacities
    #[arg(long)]
    pub keep_mip: bool,
    /// Which files a capture may refer to.
    #[command(flatten)]
    pub reach: ReachArgs,
}

/// How finely a `.4dgs` file is quantised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PrecisionArg {
    /// Larger file, smaller error
    Fine,
    /// The format's default
    Normal,
    /// Smaller file, larger error
    Coarse,
}

/// Parses the name of an export format.
pub fn format(text: &str) -> Result<Format, String> {
    text.parse().map_err(|e: minute4d::export::ExportError| e.to_string())
}
