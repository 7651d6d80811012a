//! `minute4d import`

use super::export::format;
use super::values::{rate, share};
use clap::Args;
use minute4d::export::Format;
use std::path::PathBuf;

/// `minute4d import`
#[derive(Debug, Args)]
pub struct Import {
    /// A .4dgs, .splatv, .spz or .glb file, or a PLY file of splats as 3DGS writes it: they become a scene. NAME_droid.npz,
    /// NAME_sgd_cvd_hr.npz or a folder reconstructions/NAME of MegaSaM: they become a capture
    pub file: PathBuf,
    /// Folder for the scene, as of a run, or for the capture
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// The format [default: what the name ends in, or what is in the folder]
    #[arg(long, value_name = "FORMAT", value_parser = format)]
    pub format: Option<Format>,
    /// Frames a second of a capture, which the files of MegaSaM do not say [default: 30]
    #[arg(long, value_name = "FPS", value_parser = rate)]
    pub fps: Option<f64>,
    /// A pixel of a capture moves where 1 - motion_prob is above this, 0 to 1 [default: 0.7]
    #[arg(long, value_name = "TAU", value_parser = share)]
    pub tau_motion: Option<f64>,
    /// The motion_prob.npy of a capture [default: reconstructions/NAME/motion_prob.npy beside the file or its folder, or
    /// motion_prob.npy beside it]
    #[arg(long, value_name = "FILE")]
    pub motion_prob: Option<PathBuf>,
    /// Replace what an earlier run left in the folder; other files in it stay
    #[arg(long)]
    pub force: bool,
}
