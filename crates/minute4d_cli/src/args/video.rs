//! The part of a video that is read.

use super::MethodArgs;
use super::values::{degrees, seconds};
use clap::Args;

/// The part of a video that is read, and how.
#[derive(Debug, Args)]
pub struct VideoArgs {
    /// Maximum number of frames to train on, sampled evenly over the clip; geometry may use up to four times as many
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    pub max_frames: Option<u32>,
    /// Downscale frames so that their longest side is at most this many pixels
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..=8192))]
    pub size: Option<u32>,
    /// Start time in the clip, seconds
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub start: Option<f64>,
    /// End time in the clip, seconds
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub end: Option<f64>,
    /// Horizontal field of view of the camera in degrees, if known
    #[arg(long, value_name = "DEG", value_parser = degrees)]
    pub fov: Option<f64>,
    /// Treat the camera as static; depth is then a placeholder
    #[arg(long)]
    pub static_camera: bool,
    /// Methods, and geometry that the user provides.
    #[command(flatten)]
    pub methods: MethodArgs,
    /// Refuse a video with damaged frames instead of dropping these frames
    #[arg(long)]
    pub strict_video: bool,
}
