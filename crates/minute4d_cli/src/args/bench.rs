//! `minute4d bench`

use super::values::image_size;
use clap::{Args, ValueEnum};
use minute4d::device::DeviceChoice;
use std::path::PathBuf;

/// `minute4d bench`
#[derive(Debug, Args)]
pub struct Bench {
    /// Numbers of splats in the synthetic scenes [default: 20000,100000,300000]
    #[arg(long, value_name = "N", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=20_000_000))]
    pub splats: Option<Vec<u32>>,
    /// Image sizes in pixels [default: 480x360,960x720]
    #[arg(long, value_name = "WxH", value_delimiter = ',', value_parser = image_size)]
    pub size: Option<Vec<(u16, u16)>>,
    /// Kinds of synthetic scene, static or dynamic [default: both]
    #[arg(long, value_enum, value_delimiter = ',')]
    pub scene: Option<Vec<BenchScene>>,
    /// Number of steps timed per view; the fastest counts [default: 15]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub steps: Option<u32>,
    /// Degree of the spherical harmonics that represent colour
    #[arg(long, value_name = "D", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=3))]
    pub sh_degree: u8,
    /// Measure rendering only, in frames per second
    #[arg(long)]
    pub render: bool,
    /// Short run: 100,000 splats at 480x360 and few steps, unless other options say otherwise
    #[arg(long)]
    pub quick: bool,
    /// Device: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or `auto` (a hardware GPU if there is one,
    /// else the CPU)
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    pub device: DeviceChoice,
    /// Limit of GPU memory in megabytes; a benchmark that needs more is refused
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u32).range(1..))]
    pub max_vram: Option<u32>,
    /// Measure the peak memory of training on synthetic clips instead
    #[arg(long, conflicts_with_all = ["scene", "steps", "sh_degree", "render", "quick", "device", "max_vram"])]
    pub memory: bool,
    /// Numbers of frames of the synthetic clips [default: 96,400]
    #[arg(long, value_name = "N", value_delimiter = ',', requires = "memory", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    pub frames: Option<Vec<u32>>,
    /// Write DATE-MACHINE.json and .md into this folder [default: bench/runs]
    #[arg(long, value_name = "DIR", num_args = 0..=1, default_missing_value = "bench/runs")]
    pub save: Option<PathBuf>,
}

/// A synthetic scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum BenchScene {
    /// Every splat is visible at all times
    Static,
    /// Four of five splats are visible for one or two of 64 frames
    #[value(name = "4d")]
    FourD,
}
