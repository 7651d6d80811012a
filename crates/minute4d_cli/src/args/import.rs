//! `minute4d import`

use super::ReachArgs;
use super::values::{positive, rate, share};
use clap::{Args, ValueEnum};
use minute4d::import::{ImportFormat, ImportJob, ImportOptions};
use minute4d::io::capture::Axes;
use std::path::PathBuf;

/// `minute4d import`
#[derive(Debug, Args)]
pub struct Import {
    /// A clip with poses of another tool (COLMAP, nerfstudio, ViPE, MegaSaM, DyCheck, NVIDIA, Record3D): it becomes a capture. A .4dgs file, or
    /// a PLY file of splats as 3DGS writes it: they become a scene
    #[arg(value_name = "SOURCE")]
    pub file: PathBuf,
    /// Folder for the capture, or for the scene, as of a run
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// The format [default: what the name, the files of the folder and their first bytes say]
    #[arg(long, value_name = "FORMAT", value_parser = format)]
    pub format: Option<ImportFormat>,
    /// Frames a second, where the files have no clock [default: 30]
    #[arg(long, value_name = "FPS", value_parser = rate)]
    pub fps: Option<f64>,
    /// Pictures, a folder or a video, where they lie elsewhere [default: where the format has them]
    #[arg(long, visible_alias = "pictures", value_name = "PATH")]
    pub images: Option<PathBuf>,
    /// Depth maps in place of those of the source: a folder with one a frame (16-bit PNG, EXR, PFM, npy) or an npz
    #[arg(long, value_name = "PATH")]
    pub depth: Option<PathBuf>,
    /// Scene units a step of 16-bit depth maps [default: what the format says, or 0.001]
    #[arg(long, value_name = "UNIT", value_parser = positive)]
    pub depth_unit: Option<f64>,
    /// Masks of what moves in place of those of the source: a folder with one a frame, or an npz
    #[arg(long, value_name = "PATH")]
    pub masks: Option<PathBuf>,
    /// Masks mean the opposite of what the format says
    #[arg(long)]
    pub invert_masks: bool,
    /// Tracks of points: an npz of TAPIP3D, SpatialTracker or CoTracker
    #[arg(long, value_name = "FILE")]
    pub tracks: Option<PathBuf>,
    /// Axes of the cameras, where the format leaves them open [default: told by the files]
    #[arg(long, value_enum, value_name = "AXES")]
    pub axes: Option<AxesArg>,
    /// By what the pictures of a data set are shrunk, as DyCheck's rgb/2x [default: what the protocols use]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub factor: Option<u32>,
    /// A pixel of MegaSaM's moves where 1 - motion_prob is above this, 0 to 1 [default: 0.7]
    #[arg(long, value_name = "TAU", value_parser = share)]
    pub tau_motion: Option<f64>,
    /// The motion_prob.npy of MegaSaM [default: reconstructions/NAME/motion_prob.npy beside the file or its folder, or
    /// motion_prob.npy beside it]
    #[arg(long, value_name = "FILE")]
    pub motion_prob: Option<PathBuf>,
    /// Put right what the check finds: axes, direction of poses, unit of depth, focal length, half-pixel shifts
    #[arg(long, conflicts_with = "no_check")]
    pub fix: bool,
    /// Do not compare cameras and depth with the flow of the pictures
    #[arg(long)]
    pub no_check: bool,
    /// Replace what an earlier run left in the folder; other files in it stay
    #[arg(long)]
    pub force: bool,
    /// Which files it may name.
    #[command(flatten)]
    pub reach: ReachArgs,
}

/// Axes of cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum AxesArg {
    /// x right, y up, z back: nerfstudio, Blender
    Opengl,
    /// x right, y down, z forward: COLMAP, Instant4D
    Opencv,
}

impl Import {
    /// As the library takes it.
    pub fn job(&self) -> ImportJob {
        let defaults = ImportOptions::default();
        ImportJob {
            existing: if self.force {
                minute4d::Existing::Force
            } else {
                minute4d::Existing::Refuse
            },
            options: ImportOptions {
                fps: self.fps,
                pictures: self.images.clone(),
                depth: self.depth.clone(),
                depth_unit: self.depth_unit,
                masks: self.masks.clone(),
                invert_masks: self.invert_masks,
                tracks: self.tracks.clone(),
                axes: self.axes.map(|axes| match axes {
                    AxesArg::Opengl => Axes::OpenGl,
                    AxesArg::Opencv => Axes::OpenCv,
                }),
                tau_motion: self.tau_motion.unwrap_or(defaults.tau_motion),
                factor: self.factor,
                reach: self.reach.reach(),
                ..defaults
            },
            motion: self.motion_prob.clone(),
            check: !self.no_check,
            fix: self.fix,
            ..ImportJob::new(self.format)
        }
    }
}

/// The name of a format.
fn format(text: &str) -> Result<ImportFormat, String> {
    text.parse().map_err(|e: minute4d::import::ImportError| e.to_string())
}
