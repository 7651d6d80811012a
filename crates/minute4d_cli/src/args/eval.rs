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
    /// Grow the masks of moving parts by this much first, pixels
    #[arg(long, value_name = "PX", default_value_t = 0)]
    pub grow_mask: usize,
    /// Judge by a protocol, which fixes frames, masks, metrics and poses: holdout, instant4d, rodygs, dycheck, nvidia, davis; eval.json then
    /// names every choice
    #[arg(long, value_name = "PROTOCOL")]
    pub protocol: Option<Protocol>,
    /// Masks of co-visibility, PNG files named as the pictures of the views [default: the folder covisible of the capture, or masks made
    /// from its poses and depth]
    #[arg(long, value_name = "DIR", requires = "protocol")]
    pub covisible: Option<PathBuf>,
    /// Refine the poses of test pictures against these pictures, as the protocol's peers do
    #[arg(long, requires = "protocol")]
    pub refine_poses: bool,
    /// Where the views are drawn: `cpu`, `gpu`, `gpu:N` or `auto`, as for `render`
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = device)]
    pub device: DeviceChoice,
    /// Which files it may name.
    #[command(flatten)]
    pub reach: ReachArgs,
}

/// `minute4d eval-geometry`
#[derive(Debug, Args)]
pub struct EvalGeometry {
    /// The capture to judge
    pub capture: PathBuf,
    /// What is true: a capture folder, a transforms file, or a JSON file of LLFF poses
    #[arg(long, value_name = "SCENE")]
    pub truth: PathBuf,
    /// Which files it may name.
    #[command(flatten)]
    pub reach: ReachArgs,
}
