//! `minute4d export`: writes a scene for other viewers, or a capture for COLMAP or nerfstudio.

use crate::failure::Failure;
use crate::options::{ReachArgs, choice, rate};
use crate::output::Output;
use clap::Args;
use clap::builder::TypedValueParser;
use minute4d::export::{ExportJob, Format};
use minute4d::io::scene::fourdgs::{FourdgsConfig, Precision};
use minute4d::render::Moment;
use std::path::PathBuf;

/// `minute4d export`
#[derive(Debug, Args)]
pub struct Export {
    /// The folder of a run or a scene file; for colmap and nerfstudio a capture
    pub scene: PathBuf,
    /// Output format [default: by the extension of --out, or 4dgs]. 4dgs, splatv: the whole clip; ply, spz, gltf: one
    /// instant; ply-sequence: one file per frame; colmap, nerfstudio: cameras, images, masks and points of a capture (and depth);
    /// mp4: a video rendered from the source cameras
    #[arg(long, value_name = "FORMAT")]
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
    #[arg(long, value_name = "P", default_value = "normal", value_parser = precisions())]
    pub precision: Precision,
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

fn precisions() -> impl TypedValueParser<Value = Precision> {
    choice([
        ("fine", "Larger file, smaller error", Precision::Fine),
        ("normal", "The format's default", Precision::Normal),
        ("coarse", "Smaller file, larger error", Precision::Coarse),
    ])
}

pub fn run(args: &Export, output: &Output) -> Result<(), Failure> {
    let named = args.out.as_deref().and_then(Format::of_path);
    let time = args.time.as_deref().map(str::parse::<Moment>).transpose();
    let time = time.map_err(minute4d::Error::from)?;
    let job = ExportJob {
        out: args.out.clone(),
        time,
        fps: args.fps,
        replace: args.force,
        compare: !args.no_compare,
        keep_mip: args.keep_mip,
        reach: args.reach.reach(),
        fourdgs: FourdgsConfig { precision: args.precision, ..FourdgsConfig::default() },
        ..ExportJob::new(args.format.or(named).unwrap_or(Format::Fourdgs))
    };
    let report = minute4d::export::make(&args.scene, &job, output)?;
    output.note(&report.to_string());
    output.result(&report.path.display().to_string(), minute4d::plain_json(&report)?);
    Ok(())
}
