//! `minute4d-lab bench`: milliseconds per kernel, next to the limits of the machine.

use crate::bench::{self, BenchConfig};
use clap::Args;
use clap::builder::TypedValueParser;
use m4_kernels::bench::SceneKind;
use minute4d::device::DeviceChoice;
use minute4d_cli::Common;
use minute4d_cli::failure::Failure;
use minute4d_cli::options::{choice, image_size, vram_limit};
use minute4d_cli::output::Output;
use minute4d_cli::processor;

#[derive(Debug, Args)]
pub struct Bench {
    /// Numbers of splats in the synthetic scenes [default: 20000,100000,300000]
    #[arg(long, value_name = "N", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=20_000_000))]
    pub splats: Option<Vec<u32>>,
    /// Image sizes in pixels [default: 480x360,960x720]
    #[arg(long, value_name = "WxH", value_delimiter = ',', value_parser = image_size)]
    pub size: Option<Vec<(usize, usize)>>,
    /// Kinds of synthetic scene, static or dynamic [default: both]
    #[arg(long, value_delimiter = ',', value_parser = scene_kinds())]
    pub scene: Option<Vec<SceneKind>>,
    /// Number of steps timed per view; the fastest counts [default: 15]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub steps: Option<u32>,
    /// Short run: 100,000 splats at 480x360 and few steps, unless other options say otherwise
    #[arg(long)]
    pub quick: bool,
    /// Device: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or `auto` (the
    /// best GPU, falling back to the CPU)
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    pub device: DeviceChoice,
    /// Limit of GPU memory in megabytes; a benchmark that needs more is refused
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u32).range(1..))]
    pub max_vram: Option<u32>,
}

fn scene_kinds() -> impl TypedValueParser<Value = SceneKind> {
    choice([
        (
            "static",
            "Every splat is visible at all times",
            SceneKind::Static,
        ),
        (
            "4d",
            "Four of five splats are visible for one or two of 64 frames",
            SceneKind::FourD,
        ),
    ])
}

const QUICK_STEPS: usize = 5;

pub fn run(args: &Bench, common: &Common, output: &Output) -> Result<(), Failure> {
    let report = bench::run(&config(args, common)?, output)?;
    Ok(output.result(report.to_markdown(), &report)?)
}

fn config(args: &Bench, common: &Common) -> Result<BenchConfig, Failure> {
    let mut config = BenchConfig::default();
    if args.quick {
        config.splats = vec![100_000];
        config.sizes = vec![(480, 360)];
        config.steps = QUICK_STEPS;
    }
    if let Some(splats) = &args.splats {
        config.splats = splats.iter().map(|&n| n as usize).collect();
    }
    if let Some(sizes) = &args.size {
        config.sizes.clone_from(sizes);
    }
    if let Some(scenes) = &args.scene {
        config.scenes.clone_from(scenes);
    }
    if let Some(threads) = common.threads {
        config.threads = vec![usize::from(threads)];
    }
    if let Some(steps) = args.steps {
        config.steps = steps as usize;
    }
    config.device = args.device;
    config.max_vram_mb = vram_limit(args.device, args.max_vram)?;
    config.cpu = processor();
    Ok(config)
}
