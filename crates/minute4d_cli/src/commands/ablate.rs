//! `minute4d ablate`: the contribution of each part of the method.

use super::program;
use crate::failure::Failure;
use crate::options::{LengthArgs, ReachArgs, SettingsArgs, VideoArgs, print_config, settings};
use crate::output::Output;
use clap::Args;
use minute4d::ablate::{self, AblateOptions, Row};
use minute4d::device::DeviceChoice;
use minute4d::{Existing, Job};
use std::path::PathBuf;

/// `minute4d ablate`
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
    /// Rows in addition to the full method: no-seg, no-track, no-density [default: all]
    #[arg(long, value_name = "ROW,ROW", value_delimiter = ',')]
    pub rows: Vec<Row>,
    /// Dilate the masks of dynamic regions by this many pixels before scoring
    #[arg(long, value_name = "PX", default_value_t = 0)]
    pub grow_mask: usize,
    /// Device for training and networks: `cpu`, `gpu`, `gpu:N` or `auto`
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    pub device: DeviceChoice,
    /// How long to train; every row takes as many steps as the full one.
    #[command(flatten)]
    pub length: LengthArgs,
    /// The part of the video.
    #[command(flatten)]
    pub video: VideoArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// Which files the capture may refer to.
    #[command(flatten)]
    pub reach: ReachArgs,
}

pub fn run(args: &Ablate, output: &Output) -> Result<(), Failure> {
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
