//! `minute4d import`: turns files of another tool into a scene or a capture. `minute4d export`: writes a scene for other viewers, or a
//! capture for COLMAP or nerfstudio.

use crate::failure::Failure;
use crate::options::{ReachArgs, choice, positive, rate, share};
use crate::output::Output;
use clap::Args;
use clap::builder::TypedValueParser;
use minute4d::Existing;
use minute4d::export::{ExportJob, Format};
use minute4d::import::{CaptureReport, ImportFormat, ImportJob, ImportOptions, ImportReport, Report};
use minute4d::io::capture::Axes;
use minute4d::io::scene::fourdgs::{FourdgsConfig, Precision};
use minute4d::render::Moment;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct Import {
    /// A clip with poses from another tool (COLMAP, nerfstudio, ViPE, MegaSaM, DyCheck, NVIDIA, Record3D), which becomes a capture; or a .4dgs
    /// file or a 3DGS PLY file, which becomes a scene
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
    /// Depth maps that replace those of the source: a folder with one file per frame (16-bit PNG, EXR, PFM, npy), or an npz
    #[arg(long, value_name = "PATH")]
    pub depth: Option<PathBuf>,
    /// Scene units per step of 16-bit depth maps [default: as the format defines, or 0.001]
    #[arg(long, value_name = "UNIT", value_parser = positive)]
    pub depth_unit: Option<f64>,
    /// Masks of dynamic regions that replace those of the source: a folder with one file per frame, or an npz
    #[arg(long, value_name = "PATH")]
    pub masks: Option<PathBuf>,
    /// Invert the masks, if they mean the opposite of what the format defines
    #[arg(long)]
    pub invert_masks: bool,
    /// Point tracks: an npz of TAPIP3D, SpatialTracker or CoTracker
    #[arg(long, value_name = "FILE")]
    pub tracks: Option<PathBuf>,
    /// Axis convention of the cameras, if the format does not define it [default: detected]
    #[arg(long, value_name = "AXES", value_parser = axes())]
    pub axes: Option<Axes>,
    /// Downscaling factor of a data set's images, such as 2 for DyCheck's rgb/2x [default: that of the protocols]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub factor: Option<u32>,
    /// Threshold of 1 - motion_prob above which a pixel of a MegaSaM clip is dynamic, 0 to 1 [default: 0.7]
    #[arg(long, value_name = "TAU", value_parser = share)]
    pub tau_motion: Option<f64>,
    /// MegaSaM's motion_prob.npy [default: reconstructions/NAME/motion_prob.npy next to the file or its folder, or
    /// motion_prob.npy next to the file]
    #[arg(long, value_name = "FILE")]
    pub motion_prob: Option<PathBuf>,
    /// Correct the convention errors that the check finds: axes, pose direction, depth unit, focal length, half-pixel shifts
    #[arg(long, conflicts_with = "no_check")]
    pub fix: bool,
    /// Skip the check of cameras and depth against the optical flow of the images
    #[arg(long)]
    pub no_check: bool,
    /// Replace the results of an earlier import in the folder; other files are kept
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub reach: ReachArgs,
}

fn axes() -> impl TypedValueParser<Value = Axes> {
    choice([
        ("opengl", "x right, y up, z back: nerfstudio, Blender", Axes::OpenGl),
        ("opencv", "x right, y down, z forward: COLMAP, Instant4D", Axes::OpenCv),
    ])
}

impl Import {
    fn job(&self) -> ImportJob {
        let defaults = ImportOptions::default();
        ImportJob {
            existing: if self.force { Existing::Force } else { Existing::Refuse },
            options: ImportOptions {
                fps: self.fps,
                images: self.images.clone(),
                depth: self.depth.clone(),
                depth_unit: self.depth_unit,
                masks: self.masks.clone(),
                invert_masks: self.invert_masks,
                tracks: self.tracks.clone(),
                axes: self.axes,
                tau_motion: self.tau_motion.unwrap_or(defaults.tau_motion),
                motion: self.motion_prob.clone(),
                factor: self.factor,
                reach: self.reach.reach(),
                ..defaults
            },
            check: !self.no_check,
            fix: self.fix,
            ..ImportJob::new(self.format)
        }
    }
}

pub fn import(args: &Import, output: &Output) -> Result<(), Failure> {
    let report = minute4d::import::make(&args.file, &args.out, &args.job(), output)?;
    match &report {
        Report::Scene(scene) => output.note(&of_scene(scene)),
        Report::Capture(capture) => {
            output.note(&of_capture(capture));
            if let Some(check) = &capture.check {
                output.note(&check.to_string());
            }
        }
    }
    output.result(&args.out.display().to_string(), minute4d::plain_json(&report)?);
    Ok(())
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

pub fn export(args: &Export, output: &Output) -> Result<(), Failure> {
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
