//! `minute4d bench`: milliseconds per kernel, next to the limits of the machine.

use super::doctor::processor;
use crate::args::{Bench, BenchScene, Common, limit};
use crate::failure::Failure;
use crate::output::Output;
use minute4d::Error;
use minute4d::bench::{self, BenchConfig, MemoryConfig, SavedReport};
use minute4d::kernels::bench::SceneKind;
use std::path::{Path, PathBuf};

/// Number of steps per view with `--quick`.
const QUICK_STEPS: usize = 5;

pub fn run(args: &Bench, common: &Common, output: &Output) -> Result<(), Failure> {
    if args.memory {
        return memory(args, output);
    }
    let report = bench::run(&config(args, common)?, output)?;
    if let Some(folder) = &args.save {
        save(folder, &report, output)?;
    }
    output.result(&report.to_markdown(), minute4d::plain_json(&report)?);
    Ok(())
}

fn memory(args: &Bench, output: &Output) -> Result<(), Failure> {
    let mut config = MemoryConfig {
        cpu: processor(),
        ..MemoryConfig::default()
    };
    if let Some(frames) = &args.frames {
        config.frames = frames.iter().map(|&n| n as usize).collect();
    }
    if let Some(&(width, height)) = args.size.as_ref().and_then(|sizes| sizes.first()) {
        config.size = (usize::from(width), usize::from(height));
    }
    if let Some(&splats) = args.splats.as_ref().and_then(|splats| splats.first()) {
        config.splats = splats as usize;
    }
    let program = std::env::current_exe().map_err(|source| Error::Read {
        path: PathBuf::from("the program itself"),
        source,
    })?;
    let report = bench::memory(&program, &config, output)?;
    if let Some(folder) = &args.save {
        save(folder, &report, output)?;
    }
    output.result(&report.to_markdown(), minute4d::plain_json(&report)?);
    Ok(())
}

fn save(folder: &Path, report: &impl SavedReport, output: &Output) -> Result<(), Failure> {
    let path = bench::save(folder, report)?;
    output.note(&format!("written to {}", path.display()));
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
        config.sizes = sizes.iter().map(|&(w, h)| (usize::from(w), usize::from(h))).collect();
    }
    if let Some(scenes) = &args.scene {
        let kind = |scene: &BenchScene| match scene {
            BenchScene::Static => SceneKind::Static,
            BenchScene::FourD => SceneKind::FourD,
        };
        config.scenes = scenes.iter().map(kind).collect();
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
    config.max_vram_mb = limit(args.device, args.max_vram)?;
    config.cpu = processor();
    Ok(config)
}
