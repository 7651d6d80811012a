//! `minute4d geometry`: turns a video into a capture. `minute4d enhance`: improves the masks of a
//! capture and tracks points.

use crate::failure::Failure;
use crate::options::{
    OutArgs, ReachArgs, SettingsArgs, VideoArgs, WithoutArgs, print_config, segmenters, settings,
    trackers,
};
use crate::output::Output;
use crate::run::Job;
use crate::run::record::GeometryRecord;
use clap::Args;
use m4_core::advice::DEPTH_WEIGHTS;
use minute4d::device::DeviceChoice;
use minute4d::settings::{GeometryOptions, Segmenter, Tracker};
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct Geometry {
    /// A video or a folder of images
    #[arg(required_unless_present = "print_config")]
    pub input: Option<PathBuf>,
    /// Folder for the capture
    #[arg(
        long,
        short,
        value_name = "DIR",
        required_unless_present = "print_config"
    )]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub video: VideoArgs,
    /// Device for networks: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or
    /// `auto` (the CPU)
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    pub device: DeviceChoice,
    #[command(flatten)]
    pub without: WithoutArgs,
    #[command(flatten)]
    pub settings: SettingsArgs,
    #[command(flatten)]
    pub existing: OutArgs,
}

pub fn run(args: &Geometry, output: &Output) -> Result<(), Failure> {
    let mut settings = settings(&args.settings, Some(&args.video), None)?;
    args.without.apply(&mut settings);
    let (Some(input), Some(out), false) = (&args.input, &args.out, args.settings.print_config)
    else {
        return print_config(&settings, output);
    };
    let asked = settings.geometry.clone();
    let job = Job::new(settings, args.device, args.existing.mode(), output);
    let record = crate::run::geometry::make(input, out, &job)?;
    describe(&record, &asked, output);
    Ok(output.made(out, &record)?)
}

/// Says what geometry measured and how far it can be trusted, and in one line which weights would
/// help this clip most, unless a warning said it or none would.
pub fn describe(record: &GeometryRecord, asked: &GeometryOptions, output: &Output) {
    let Some(summary) = &record.found else { return };
    output.note(&format!(
        "{} frames, {} x {} pixels, field of view {:.1} degrees, {:.1} % dynamic, reprojection error {:.2} px",
        summary.frames,
        summary.size[0],
        summary.size[1],
        summary.fov_deg,
        100.0 * summary.moving_share,
        summary.residual_px
    ));
    if let Some(confidence) = &summary.confidence {
        output.note(&confidence.description());
    }
    if let Some(objects) = summary.objects_description() {
        output.note(&objects);
    }
    let mut warnings = record.warnings.iter();
    if warnings.any(|warning| warning.contains(DEPTH_WEIGHTS)) {
        return;
    }
    if let Some(advice) = summary.helpful_weights(asked) {
        output.note(&format!("what would help this clip most: {advice}"));
    }
}

#[derive(Debug, Args)]
pub struct Enhance {
    /// A capture with motion maps or masks of dynamic regions
    #[arg(required_unless_present = "print_config")]
    pub capture: Option<PathBuf>,
    /// Folder for the enhanced capture
    #[arg(
        long,
        short,
        value_name = "DIR",
        required_unless_present = "print_config"
    )]
    pub out: Option<PathBuf>,
    /// Segmentation method [default: auto]
    #[arg(long, value_parser = segmenters())]
    pub segmenter: Option<Segmenter>,
    /// Tracking method [default: auto]
    #[arg(long, value_parser = trackers())]
    pub tracker: Option<Tracker>,
    /// Device for networks: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or
    /// `auto` (the CPU)
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    pub device: DeviceChoice,
    #[command(flatten)]
    pub settings: SettingsArgs,
    #[command(flatten)]
    pub existing: OutArgs,
    #[command(flatten)]
    pub reach: ReachArgs,
}

pub fn enhance(args: &Enhance, output: &Output) -> Result<(), Failure> {
    let mut settings = settings(&args.settings, None, None)?;
    settings.capture.reach = args.reach.reach();
    let geometry = &mut settings.geometry;
    geometry.segmenter = args.segmenter.unwrap_or(geometry.segmenter);
    geometry.tracker = args.tracker.unwrap_or(geometry.tracker);
    let (Some(capture), Some(out), false) = (&args.capture, &args.out, args.settings.print_config)
    else {
        return print_config(&settings, output);
    };
    let job = Job::new(settings, args.device, args.existing.mode(), output);
    let report = crate::run::enhance::make(capture, out, &job)?;
    let share = |share: Option<f64>| {
        share.map_or_else(|| "unknown".to_owned(), |s| format!("{:.1} %", 100.0 * s))
    };
    output.note(&format!(
        "segmentation {}: {} objects; dynamic pixels {} before, {} now; tracking {}: {} points",
        report.segmenter,
        report.instances,
        share(report.moving_share[0]),
        share(report.moving_share[1]),
        report.tracker,
        report.tracks
    ));
    Ok(output.made(out, &report)?)
}
