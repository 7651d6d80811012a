//! The commands: their options, the call of what computes, and the result that is printed.

use crate::ablate::{self, AblateOptions, Row};
use crate::explain::{explain, explain_table};
use crate::reproduce::{GeometrySource, ReproduceOptions, Suite, TABLE_FILE, reproduce};
use clap::Args;
use clap::builder::TypedValueParser;
use minute4d::device::{DeviceChoice, DeviceRequest};
use minute4d::{Existing, Settings};
use minute4d_cli::failure::Failure;
use minute4d_cli::options::{
    LengthArgs, ReachArgs, SettingsArgs, VideoArgs, choice, print_config, settings, settings_over,
};
use minute4d_cli::output::Output;
use minute4d_cli::program;
use minute4d_cli::run::Job;
use minute4d_eval::Protocol;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct EvalGeometry {
    /// The capture to evaluate
    pub capture: PathBuf,
    /// Ground truth: a capture folder or a transforms file
    #[arg(long, value_name = "SCENE")]
    pub truth: PathBuf,
    /// Replace one kind of estimate at a time by the truth, and score the held-out views of SCENE
    /// by warping depth into them
    #[arg(long)]
    pub explain: bool,
    /// Also train each of these captures for N iterations
    #[arg(long, value_name = "N", requires = "explain", requires = "out")]
    pub train: Option<usize>,
    /// Folder for the captures and scenes of `--train`; finished scenes are kept
    #[arg(long, short, value_name = "DIR", requires = "train")]
    pub out: Option<PathBuf>,
    /// Also compare the motion that first splats get from the frames, depth and masks of SCENE with
    /// its tracks
    #[arg(long)]
    pub motion: bool,
    #[command(flatten)]
    pub reach: ReachArgs,
}

pub fn run_geometry(args: &EvalGeometry, output: &Output) -> Result<(), Failure> {
    let reach = args.reach.reach();
    let report = minute4d_eval::geometry(&args.capture, &args.truth, reach, output)?;
    let (mut text, mut value) = (report.table(), minute4d::plain_json(&report)?);
    if args.motion {
        let errors = minute4d_eval::motion(&args.truth, reach, output)?;
        text += &minute4d_eval::motion_table(&errors);
        value["motion"] = minute4d::plain_json(&errors)?;
    }
    if args.explain {
        let mut settings = Settings::fast();
        settings.capture.reach = reach;
        settings.train.iterations = args.train.unwrap_or(settings.train.iterations);
        settings.viewer.write = false;
        let job = Job::new(settings, DeviceRequest::default(), Existing::Resume, output);
        let training = args.out.as_deref().map(|out| (out, &job));
        let options = &job.settings.capture;
        let rows = explain(&args.capture, &args.truth, options, training, output)?;
        text += &explain_table(&rows);
        value["explain"] = minute4d::plain_json(&rows)?;
    }
    Ok(output.result(&text, &value)?)
}

#[derive(Debug, Args)]
pub struct Reproduce {
    /// The data set: dycheck, nvidia or davis
    pub suite: Suite,
    /// Folder with the scenes in their published layout
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Folder for the tables (reproduce.md, reproduce.json, one image per scene) and the runs;
    /// finished scenes are not run again
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// Evaluation protocols [default: those of the data set: instant4d,dycheck; nvidia; davis]
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    pub protocols: Vec<Protocol>,
    /// Scenes to run [default: those of the published tables]
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    pub scenes: Vec<String>,
    /// Downscaling factor of the images of DyCheck and NVIDIA [default: 2, as in published results]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=8))]
    pub factor: Option<u32>,
    /// Optimise the poses of test images before scoring, where published methods do under the
    /// protocol
    #[arg(long)]
    pub refine_poses: bool,
    /// Poses and depth to train with: given (those of the data set) or own (estimated from the
    /// training images; views of other cameras are then placed by alignment) [davis: always own]
    #[arg(long, value_name = "WHOSE", default_value = "given", value_parser = sources())]
    pub geometry: GeometrySource,
    /// Also run every scene without segmentation, without tracking, without loss-guided density
    /// control, and without any
    #[arg(long)]
    pub ablations: bool,
    /// Device for training, rendering and networks: `cpu`, `gpu`, `gpu:N`, or `auto` (networks on
    /// the CPU)
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    pub device: DeviceChoice,
    #[command(flatten)]
    pub length: LengthArgs,
    #[command(flatten)]
    pub settings: SettingsArgs,
    #[command(flatten)]
    pub reach: ReachArgs,
}

fn sources() -> impl TypedValueParser<Value = GeometrySource> {
    choice([
        ("given", "Those of the data set", GeometrySource::Given),
        (
            "own",
            "Estimated from the training images alone",
            GeometrySource::Own,
        ),
    ])
}

pub fn run(args: &Reproduce, output: &Output) -> Result<(), Failure> {
    let built_in = |profile| args.suite.settings(profile);
    let mut settings = settings_over(built_in, &args.settings, None, Some(&args.length))?;
    settings.capture.reach = args.reach.reach();
    if args.settings.print_config {
        return print_config(&settings, output);
    }
    let options = ReproduceOptions {
        geometry: args.geometry,
        ablations: args.ablations.then(program).transpose()?,
        protocols: args.protocols.clone(),
        scenes: args.scenes.clone(),
        factor: args.factor,
        refine_poses: args.refine_poses,
    };
    let job = Job::new(settings, args.device, Existing::Resume, output);
    let report = reproduce(args.suite, &args.data, &args.out, &options, &job)?;
    output.note(&format!(
        "tables written to {}",
        args.out.join(TABLE_FILE).display()
    ));
    Ok(output.result(report.to_markdown(), &report)?)
}

#[derive(Debug, Args)]
pub struct Ablate {
    /// A video, a folder of images, or a capture folder (whose geometry is then used)
    pub input: PathBuf,
    /// Folder for the table, with one folder per row in it; finished rows are not computed again
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// The capture whose transforms_test.json lists the held-out views [default: the input]
    #[arg(long, value_name = "CAPTURE")]
    pub data: Option<PathBuf>,
    /// Rows in addition to the full method: no-seg, no-track, no-loss-guided (densification by
    /// gradients, as 3DGS), no-density [default: all]
    #[arg(long, value_name = "ROW,ROW", value_delimiter = ',')]
    pub rows: Vec<Row>,
    /// Dilate the masks of dynamic regions by this many pixels before scoring
    #[arg(long, value_name = "PX", default_value_t = 0)]
    pub grow_mask: usize,
    /// Device for training and networks: `cpu`, `gpu`, `gpu:N`, or `auto` (networks on the CPU)
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    pub device: DeviceChoice,
    #[command(flatten)]
    pub length: LengthArgs,
    #[command(flatten)]
    pub video: VideoArgs,
    #[command(flatten)]
    pub settings: SettingsArgs,
    #[command(flatten)]
    pub reach: ReachArgs,
}

pub fn ablate(args: &Ablate, output: &Output) -> Result<(), Failure> {
    let mut settings = settings(&args.settings, Some(&args.video), Some(&args.length))?;
    settings.capture.reach = args.reach.reach();
    if args.settings.print_config {
        return print_config(&settings, output);
    }
    let options = AblateOptions {
        program: program()?,
        rows: match args.rows.as_slice() {
            [] => Row::ALL.to_vec(),
            rows => rows.to_vec(),
        },
        data: args.data.clone(),
        grow_mask: args.grow_mask,
    };
    let job = Job::new(settings, args.device, Existing::Resume, output);
    let report = ablate::ablate(&args.input, &args.out, &options, &job)?;
    if let Some(image) = &report.image {
        output.note(&format!(
            "{}: source, without tracking, full method",
            image.display()
        ));
    }
    Ok(output.result(report.to_markdown(), &report)?)
}
