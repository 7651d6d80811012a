//! `minute4d run`: turns a video into a scene. `minute4d train`: trains a scene from a capture.

use super::geometry::describe;
use super::view::{PageArgs, while_training};
use crate::failure::Failure;
use crate::options::{OutArgs, TrainingArgs, VideoArgs, print_config};
use crate::output::{Output, duration};
use crate::run::record::{GeometryRecord, RunRecord};
use crate::run::{Job, geometry};
use clap::Args;
use minute4d::Observer;
use minute4d::layout::{CAPTURE_FOLDER, PREVIEW_FILE, VIEWER_FILE, is_capture};
use minute4d::settings::GeometryOptions;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub struct Run {
    /// A video, a folder of images, or a capture folder (whose geometry is then used)
    #[arg(required_unless_present = "print_config")]
    pub input: Option<PathBuf>,
    /// Folder for all results: scene.safetensors, viewer.html, preview.mp4, run.json,
    /// metrics.jsonl, capture/
    #[arg(
        long,
        short,
        value_name = "DIR",
        required_unless_present = "print_config"
    )]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub video: VideoArgs,
    #[command(flatten)]
    pub training: TrainingArgs,
    #[command(flatten)]
    pub page: PageArgs,
    #[command(flatten)]
    pub existing: OutArgs,
    /// Also write poster.jpg, for overviews of many clips.
    #[arg(long, hide = true)]
    pub poster: bool,
}

pub fn run(args: &Run, output: &Output) -> Result<(), Failure> {
    let mut settings = args.training.settings(Some(&args.video))?;
    settings.capture.reach = args.training.reach.reach();
    let (Some(input), Some(out), false) =
        (&args.input, &args.out, args.training.settings.print_config)
    else {
        return print_config(&settings, output);
    };
    let device = args.training.device.request()?;
    let asked = settings.geometry.clone();
    let work = |observer: &dyn Observer| {
        let job = Job::new(settings, device, args.existing.mode(), observer);
        if !is_capture(input) {
            return crate::run::run(input, out, &job, args.poster);
        }
        if job.settings.geometry != GeometryOptions::default() {
            observer.warn(
                "the input is a capture, whose geometry is used unchanged: --frontend, --segmenter, --intrinsics, --poses, --masks and \
                 --depth have no effect",
            );
        }
        crate::run::train::make(input, out, &job, args.poster)
    };
    while_training(&args.page, (input, out), output, work, |done| {
        // the input of a run may be a capture, whose geometry is not this run's
        if done.stages.contains_key(geometry::STAGE)
            && let Some(record) = GeometryRecord::read(&out.join(CAPTURE_FOLDER))?
        {
            describe(&record, &asked, output);
        }
        report(out, done, output)
    })
}

/// Reports the folder of the results, the time, and the file to open.
pub fn report(out: &Path, done: &RunRecord, output: &Output) -> Result<(), Failure> {
    let mut viewable = [VIEWER_FILE, PREVIEW_FILE].into_iter();
    let file = viewable.find(|name| done.files.contains_key(*name));
    let open = file.map_or_else(String::new, |name| {
        format!("; open {}", out.join(name).display())
    });
    output.note(&format!("finished in {}{open}", duration(done.seconds)));
    Ok(output.made(out, done)?)
}

#[derive(Debug, Args)]
pub struct Train {
    /// A capture: a folder with transforms_train.json, images, depth and masks
    #[arg(required_unless_present = "print_config")]
    pub capture: Option<PathBuf>,
    /// Folder for the scene and its records
    #[arg(
        long,
        short,
        value_name = "DIR",
        required_unless_present = "print_config"
    )]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub training: TrainingArgs,
    #[command(flatten)]
    pub page: PageArgs,
    #[command(flatten)]
    pub existing: OutArgs,
}

pub fn train(args: &Train, output: &Output) -> Result<(), Failure> {
    let mut settings = args.training.settings(None)?;
    settings.capture.reach = args.training.reach.reach();
    let (Some(capture), Some(out), false) = (
        &args.capture,
        &args.out,
        args.training.settings.print_config,
    ) else {
        return print_config(&settings, output);
    };
    let device = args.training.device.request()?;
    let work = |observer: &dyn Observer| {
        let job = Job::new(settings, device, args.existing.mode(), observer);
        crate::run::train::make(capture, out, &job, false)
    };
    while_training(&args.page, (capture, out), output, work, |done| {
        report(out, done, output)
    })
}
