//! `minute4d import`: turns files of another tool into a scene or a capture. `minute4d export`:
//! writes a scene for other viewers, or a capture for COLMAP.

use crate::failure::Failure;
use crate::options::{ReachArgs, rate, unless_forced};
use crate::output::Output;
use crate::run::import::{
    CaptureReport, ImportFormat, ImportJob, ImportOptions, ImportReport, Report,
};
use clap::Args;
use minute4d::export::{ExportJob, Format};
use minute4d::render::Moment;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct Import {
    /// A clip with poses from another tool (COLMAP, nerfstudio, ViPE, MegaSaM, DyCheck, NVIDIA,
    /// Record3D), which becomes a capture; or a .4dgs file or a 3DGS PLY file, which becomes a
    /// scene
    #[arg(value_name = "SOURCE")]
    pub file: PathBuf,
    /// Folder for the capture, or for the scene (with the layout of a run)
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// Format of the source [default: detected from names and contents]
    #[arg(long, value_name = "FORMAT")]
    pub format: Option<ImportFormat>,
    /// Frames per second, for sources without timestamps [default: 30]
    #[arg(long, value_name = "FPS", value_parser = rate)]
    pub fps: Option<f64>,
    /// Folder of images or a video, if they are not where the format expects them
    #[arg(long, value_name = "PATH")]
    pub images: Option<PathBuf>,
    /// Depth maps that replace those of the source: a folder with one file per frame (16-bit PNG in
    /// steps of 0.001 scene units, EXR, npy)
    #[arg(long, value_name = "PATH")]
    pub depth: Option<PathBuf>,
    /// Masks of dynamic regions that replace those of the source: a folder with one PNG per frame
    #[arg(long, value_name = "PATH")]
    pub masks: Option<PathBuf>,
    /// Downscaling factor of a data set's images, such as 2 for DyCheck's rgb/2x [default: that of
    /// the protocols]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub factor: Option<u32>,
    /// Replace the results of an earlier import in the folder; other files are kept
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub reach: ReachArgs,
}

impl Import {
    fn job(&self) -> ImportJob {
        ImportJob {
            existing: unless_forced(self.force),
            options: ImportOptions {
                fps: self.fps,
                images: self.images.clone(),
                depth: self.depth.clone(),
                masks: self.masks.clone(),
                factor: self.factor,
                reach: self.reach.reach(),
                ..ImportOptions::default()
            },
            ..ImportJob::new(self.format)
        }
    }
}

pub fn import(args: &Import, output: &Output) -> Result<(), Failure> {
    let report = crate::run::import::make(&args.file, &args.out, &args.job(), output)?;
    match &report {
        Report::Scene(scene) => output.note(&of_scene(scene)),
        Report::Capture(capture) => output.note(&of_capture(capture)),
    }
    Ok(output.result(args.out.display(), &report)?)
}

fn of_scene(report: &ImportReport) -> String {
    format!(
        "{}: {} static and {} dynamic splats, {} frames, {}",
        report.format.name(),
        report.splats_static,
        report.splats_dynamic,
        report.time_frames,
        match report.cameras {
            0 => "no cameras".to_owned(),
            n => format!("{n} cameras"),
        }
    )
}

fn of_capture(report: &CaptureReport) -> String {
    let [w, h] = report.size;
    format!(
        "{}: {} frames of {w} x {h} pixels, field of view {:.1} degrees, depth of {:.1} % of the pixels, {}{}",
        report.format.name(),
        report.frames,
        report.fov_deg,
        100.0 * report.known_share,
        match report.moving_share {
            None => "no masks".to_owned(),
            Some(share) => format!("{:.1} % dynamic", 100.0 * share),
        },
        match report.held_out {
            0 => String::new(),
            n => format!(", {n} held-out views"),
        }
    )
}

#[derive(Debug, Args)]
pub struct Export {
    /// The folder of a run or a scene file; for colmap a capture
    pub scene: PathBuf,
    /// Output format [default: by the extension of --out, or 4dgs]. 4dgs, ftgs, splatv: the whole
    /// clip; ply, spz, gltf: one instant; ply-sequence: one file per frame; colmap: cameras,
    /// images, masks and points of a capture
    #[arg(long, value_name = "FORMAT")]
    pub format: Option<Format>,
    /// Output file, or folder for a sequence [default: scene.EXTENSION next to the scene]
    #[arg(long, short, value_name = "PATH")]
    pub out: Option<PathBuf>,
    /// Instant for formats that hold one: a frame number, or seconds with the suffix `s`, as in
    /// 1.5s [default: the middle]
    #[arg(long, value_name = "T")]
    pub time: Option<String>,
    /// Files per second for a sequence [default: the rate of the source]
    #[arg(long, value_name = "FPS", value_parser = rate)]
    pub fps: Option<f64>,
    /// Replace an existing file
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub reach: ReachArgs,
}

pub fn export(args: &Export, output: &Output) -> Result<(), Failure> {
    let named = args.out.as_deref().and_then(Format::of_path);
    if let Some(other) = args
        .out
        .as_deref()
        .filter(|out| args.format.is_none() && named.is_none() && out.extension().is_some())
    {
        let other = other.display();
        return Err(Failure::usage(&format!(
            "the extension of {other} is not that of a format; add --format (`minute4d render` makes videos)"
        )));
    }
    let time = args.time.as_deref().map(str::parse::<Moment>).transpose();
    let time = time.map_err(minute4d::Error::from)?;
    let job = ExportJob {
        out: args.out.clone(),
        time,
        fps: args.fps,
        replace: args.force,
        reach: args.reach.reach(),
        ..ExportJob::new(args.format.or(named).unwrap_or(Format::Fourdgs))
    };
    let report = minute4d::export::make(&args.scene, &job, output)?;
    output.note(&report.to_string());
    Ok(output.result(report.path.display(), &report)?)
}
