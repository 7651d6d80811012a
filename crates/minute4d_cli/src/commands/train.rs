//! `minute4d train`: trains a scene from a capture.

use super::run::report;
use super::view::{PageArgs, while_training};
use crate::failure::Failure;
use crate::options::{OutArgs, TrainingArgs, print_config};
use crate::output::Output;
use clap::Args;
use minute4d::{Job, Observer};
use std::path::PathBuf;

/// `minute4d train`
#[derive(Debug, Args)]
pub struct Train {
    /// A capture: a folder with transforms_train.json, images, depth and masks
    #[arg(required_unless_present = "print_config")]
    pub capture: Option<PathBuf>,
    /// Folder for the scene and its records
    #[arg(long, short, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// How to train.
    #[command(flatten)]
    pub training: TrainingArgs,
    /// The viewer page.
    #[command(flatten)]
    pub page: PageArgs,
    /// What may happen to an existing folder.
    #[command(flatten)]
    pub existing: OutArgs,
}

pub fn run(args: &Train, output: &Output) -> Result<(), Failure> {
    let mut settings = args.training.settings(None)?;
    settings.capture.reach = args.training.reach.reach();
    let (Some(capture), Some(out), false) = (&args.capture, &args.out, args.training.settings.print_config) else {
        return print_config(&settings, output);
    };
    let device = args.training.device.request()?;
    let work = |observer: &dyn Observer| {
        let job = Job { settings, device, existing: args.existing.mode(), observer };
        minute4d::train::make(capture, out, &job)
    };
    while_training(&args.page, (capture, out), output, work, |done| report(out, done, output))
}
