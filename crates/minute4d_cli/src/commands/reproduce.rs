//! `minute4d reproduce`: the tables of published results; `minute4d ablate`: the contribution of each part of the method.

use super::program;
use crate::failure::Failure;
use crate::options::{LengthArgs, ReachArgs, SettingsArgs, VideoArgs, choice, print_config, settings, settings_over};
use crate::output::Output;
use clap::Args;
use clap::builder::TypedValueParser;
use minute4d::ablate::{self, AblateOptions, Row};
use minute4d::device::DeviceChoice;
use minute4d::evaluate::Protocol;
use minute4d::reproduce::{GeometrySource, ReproduceOptions, Suite, TABLE_FILE, reproduce};
use minute4d::{Existing, Job};
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct Reproduce {
    /// The data set: dycheck, nvidia or davis
    pub suite: Suite,
    /// Folder with the scenes in their published layout
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Folder for the tables (reproduce.md, reproduce.json, one image per scene) and the runs; finished scenes are not run again
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
    /// Optimise the poses of test images before scoring, where published methods do under the protocol
    #[arg(long)]
    pub refine_poses: bool,
    /// Poses and depth to train with: given (those of the data set) or own (estimated from the training images; views of other cameras are
    /// then placed by alignment) [davis: always own]
    #[arg(long, value_name = "WHOSE", default_value = "given", value_parser = sources())]
    pub geometry: GeometrySource,
    /// Also run every scene without segmentation, without tracking, without loss-guided density control, and without any
    #[arg(long)]
    pub ablations: bool,
    /// Device for training, rendering and networks: `cpu`, `gpu`, `gpu:N`, or `auto` (networks on the CPU)
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
        ("own", "Estimated from the training images alone", GeometrySource::Own),
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
    let job = Job { settings, device: args.device.into(), existing: Existing::Resume, observer: output };
    let report = reproduce(args.suite, &args.data, &args.out, &options, &job)?;
    output.note(&format!("tables written to {}", args.out.join(TABLE_FILE).display()));
    output.result(&report.to_markdown(), minute4d::plain_json(&report)?);
    Ok(())
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
    /// Rows in addition to the full method: no-seg, no-track, no-loss-guided (densification by gradients, as 3DGS), no-density [default: all]
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
    let job = Job { settings, device: args.device.into(), existing: Existing::Resume, observer: output };
    let report = ablate::ablate(&args.input, &args.out, &options, &job)?;
    if let Some(image) = &report.image {
        output.note(&format!("{}: source, without tracking, full method", image.display()));
    }
    output.result(&report.to_markdown(), minute4d::plain_json(&report)?);
    Ok(())
}
