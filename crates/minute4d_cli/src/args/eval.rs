//! `minute4d eval` and `minute4d eval-geometry`

use super::ReachArgs;
use super::device::device;
use clap::Args;
use minute4d::device::DeviceChoice;
use minute4d::evaluate::Protocol;
use std::path::PathBuf;

/// `minute4d eval`
#[derive(Debug, Args)]
pub struct Eval {
    /// The folder of a run; eval.json is written into it
    pub out: PathBuf,
    /// The capture whose transforms_test.json lists the held-out views
    #[arg(long, value_name = "CAPTURE")]
    pub data: PathBuf,
    /// Dilate the masks of dynamic regions by this many pixels first
    #[arg(long, value_name = "PX", default_value_t = 0)]
    pub grow_mask: usize,
    /// Evaluation protocol, which fixes frames, masks, metrics and poses: holdout, instant4d, rodygs, dycheck, nvidia, davis; eval.json then
    /// records every choice
    #[arg(long, value_name = "PROTOCOL")]
    pub protocol: Option<Protocol>,
    /// Folder of co-visibility masks, PNG files named like the images of the views [default: the capture's folder covisible, or masks
    /// computed from its poses and depth]
    #[arg(long, value_name = "DIR", requires = "protocol")]
    pub covisible: Option<PathBuf>,
    /// Optimise the poses of test images before scoring, as published methods do under this protocol
    #[arg(long, requires = "protocol")]
    pub refine_poses: bool,
    /// Device that renders the views: `cpu`, `gpu`, `gpu:N` or `auto`
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = device)]
    pub device: DeviceChoice,
    /// Which files the capture may refer to.
    #[command(flatten)]
    pub reach: ReachArgs,
}

/// `minute4d eval-geometry`
#[derive(Debug, Args)]
pub struct EvalGeometry {
    /// The capture to evaluate
    pub capture: PathBuf,
    /// Ground truth: a capture folder, a transforms file, or a JSON file of LLFF poses
    #[arg(long, value_name = "SCENE")]
    pub truth: PathBuf,
    /// Which files the capture may refer to.
    #[command(flatten)]
    pub reach: ReachArgs,
}
