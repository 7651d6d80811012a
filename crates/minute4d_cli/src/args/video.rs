//! Which part of a video is read.

use super::KnownArgs;
use super::values::{degrees, seconds};
use clap::Args;

/// Which part of a video is read, and how.
#[derive(Debug, Args)]
pub struct VideoArgs {
    /// At most this many frames, evenly spread over the clip
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    pub max_frames: Option<u32>,
    /// Shrink frames so that their longest side is at most this, pixels
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..=8192))]
    pub size: Option<u32>,
    /// Begin here, seconds into the clip
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub start: Option<f64>,
    /// Stop here, seconds into the clip
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub end: Option<f64>,
    /// Horizontal field of view of the camera, degrees, where it is known
    #[arg(long, value_name = "DEG", value_parser = degrees)]
    pub fov: Option<f64>,
    /// Treat the camera as static; depth is then a placeholder
    #[arg(long)]
    pub static_camera: bool,
    /// What replaces a part of the computation.
    #[command(flatten)]
    pub known: KnownArgs,
    /// Refuse a video with damaged frames instead of going on without them
    #[arg(long)]
    pub strict_video: bool,
}
