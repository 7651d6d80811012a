//! `minute4d bench`: milliseconds per kernel, next to the limits of the machine.

use super::doctor::processor;
use super::program;
use crate::cli::Common;
use crate::failure::Failure;
use crate::options::{choice, image_size, vram_limit};
use crate::output::Output;
use clap::Args;
use clap::builder::TypedValueParser;
use minute4d::bench::{self, BenchConfig, MemoryConfig};
use minute4d::device::DeviceChoice;
use minute4d::kernels::bench::SceneKind;
use std::path::PathBuf;

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

fn scene_kinds() -> impl TypedValueParser<Value = SceneKind> {
    choice([
        ("static", "Every splat is visible at all times", SceneKind::Static),
        ("4d", "Four of five splats are visible for one or two of 64 frames", SceneKind::FourD),
    ])
}

const QUICK_STEPS: usize = 5;

pub fn run(args: &Bench, common: &Common, output: &Output) -> Result<(), Failure> {
    if args.memory {
        return memory(args, output);
    }
    let report = bench::run(&config(args, common)?, output)?;
    if let Some(folder) = &args.save {
        output.note(&format!("written to {}", report.save(folder)?.display()));
    }
    output.result(&report.to_markdown(), minute4d::plain_json(&report)?);
    Ok(())
}

fn memory(args: &Bench, output: &Output) -> Result<(), Failure> {
    let mut config = MemoryConfig { cpu: processor(), ..MemoryConfig::default() };
    if let Some(frames) = &args.frames {
        config.frames = frames.iter().map(|&n| n as usize).collect();
    }
    if let Some(&size) = args.size.as_ref().and_then(|sizes| sizes.first()) {
        config.size = size;
    }
    if let Some(&splats) = args.splats.as_ref().and_then(|splats| splats.first()) {
        config.splats = splats as usize;
    }
    let report = bench::memory(&program()?, &config, output)?;
    if let Some(folder) = &args.save {
        output.note(&format!("written to {}", report.save(folder)?.display()));
    }
    output.result(&report.to_markdown(), minute4d::plain_json(&report)?);
    Ok(())
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
    config.sh_degree = usize::from(args.sh_degree);
    config.render_only = args.render;
    config.device = args.device;
    config.max_vram_mb = vram_limit(args.device, args.max_vram)?;
    config.cpu = processor();
    Ok(config)
}
