//! Benchmark cases on a GPU.

use super::report::GpuMachine;
use super::{BenchConfig, Case, Fastest, GpuCase, Millis, Step, Timed, case, mean_over};
use cpu_time::ProcessTime;
use m4_kernels::bench::{Bench as Host, Counts, Probe, SceneConfig};
use m4_kernels::gpu::{Choice, Gpu, GpuError, Laps, adapters, automatic};
use m4_kernels::plan::Plan;
use m4_kernels::renderer::gpu::Size;
use m4_kernels::{SimdLevel, StepStats};
use m4_train::backend::gpu::{Bench, Drawing};
use minute4d::device::DeviceChoice;
use minute4d::observer::check_stop;
use minute4d::{Error, Observer};
use std::time::{Duration, Instant};

/// Steps are repeated until they take at least this long, so that the one wait does not count.
const LONG: Duration = Duration::from_millis(500);
/// Repetitions; the fastest counts.
const REPEATS: usize = 3;
/// Most steps without waiting between them.
const MOST: usize = 20_000;
/// Share of SSIM in the loss, as [`Bench`] has it.
const LAMBDA_SSIM: f64 = 0.2;

/// The GPU that is chosen, started; `None` for the processor.
pub(super) fn open(device: DeviceChoice) -> Result<Option<Gpu>, Error> {
    let choice = match device {
        DeviceChoice::Cpu => return Ok(None),
        DeviceChoice::Auto => match automatic(adapters()) {
            Some(adapter) => Choice::Index(adapter.index),
            None => return Ok(None),
        },
        DeviceChoice::Gpu(None) => Choice::Best,
        DeviceChoice::Gpu(Some(index)) => Choice::Index(index),
    };
    Ok(Some(Gpu::open(choice)?))
}

/// What the report says of it.
pub(super) fn machine(gpu: &Gpu) -> GpuMachine {
    let adapter = gpu.adapter();
    GpuMachine {
        name: adapter.name.clone(),
        kind: format!("{:?}", adapter.kind).to_lowercase(),
        api: adapter.api.clone(),
        driver: adapter.driver.clone(),
    }
}

/// Times `scene`.
pub(super) fn run(
    gpu: &Gpu,
    level: SimdLevel,
    scene: &SceneConfig,
    config: &BenchConfig,
    observer: &dyn Observer,
) -> Result<Case, Error> {
    let mut host = Host::new(level, scene).map_err(Error::internal)?;
    let mut counts: Vec<Counts> = (0..host.views()).map(|view| host.count(view)).collect();
    let drawn = host.into_scene();
    let layout = drawn.splats.layout();
    let (n, n_static) = (drawn.splats.n(), drawn.splats.n_static());
    let plan = |entries| {
        let size = (scene.width, scene.height);
        Plan::training(n_static, n - n_static, layout, size, 1, entries)
    };
    let limit = config
        .max_vram_mb
        .map_or(u64::MAX, |mb| 1_000_000 * mb as u64);
    let first = plan(Size::first_entries(n));
    first.check(limit)?;
    first.check_buffers(gpu)?;

    // what the case before left there
    gpu.give_back()?;
    let mut bench = Bench::new(gpu.clone(), drawn)?;
    // tiles of the GPU are larger than those of the processor: lists of its own, all of which is
    // looked at
    for (view, counts) in counts.iter_mut().enumerate() {
        counts.pairs = bench.entries(view)?;
        counts.used = counts.pairs;
    }
    let plan = plan(bench.room());
    plan.check(limit)?;
    let own_clock = bench.own_clock();
    let steps = time_steps(&mut bench, config.steps, observer)?;
    let memory = bench.memory();
    let mut drawing = bench.into_drawing()?;
    let frames = time_frames(&mut drawing, config.steps, observer)?;
    drop(drawing);
    let probe = Probe::of_device(gpu)?;
    let figures = GpuCase {
        own_clock,
        behind_one_another: steps.count,
        read_frames_per_s: 1e3 / frames.read_ms,
        planned_bytes: plan.total(),
        in_use_bytes: memory.in_use,
        reserved_bytes: memory.reserved,
    };
    let timed = Timed {
        kernels: steps.kernels,
        step: steps.step,
        render_ms: frames.ms,
    };
    Ok(case(scene, &counts, None, &probe, timed, Some(figures)))
}

struct Steps {
    kernels: Millis,
    step: Step,
    count: usize,
}

fn time_steps(bench: &mut Bench, steps: usize, observer: &dyn Observer) -> Result<Steps, Error> {
    let views = bench.views();
    let kernels = fastest(views, steps, |view| bench.laps(view))?;
    bench.stats()?;
    all_views(bench, views)?;
    let before = loss(&bench.stats()?);
    let (ms, busy, count) = behind_one_another(steps, views, observer, |rounds| {
        for _ in 0..rounds {
            all_views(bench, views)?;
        }
        bench.wait()
    })?;
    bench.stats()?;
    all_views(bench, views)?;
    Ok(Steps {
        kernels,
        step: Step {
            ms,
            busy,
            loss: [before, loss(&bench.stats()?)],
        },
        count,
    })
}

fn all_views(bench: &mut Bench, views: usize) -> Result<(), GpuError> {
    (0..views).try_for_each(|view| bench.step(view))
}

fn loss(stats: &StepStats) -> f64 {
    (1.0 - LAMBDA_SSIM) * stats.l1 + LAMBDA_SSIM * (1.0 - stats.ssim)
}

struct Frames {
    ms: f64,
    read_ms: f64,
}

fn time_frames(
    drawing: &mut Drawing,
    frames: usize,
    observer: &dyn Observer,
) -> Result<Frames, Error> {
    let views = drawing.views();
    // the first round compiles kernels
    (0..views).for_each(|view| drawing.draw(view));
    drawing.wait()?;
    let (ms, ..) = behind_one_another(frames, views, observer, |rounds| {
        for _ in 0..rounds {
            (0..views).for_each(|view| drawing.draw(view));
        }
        drawing.wait()
    })?;
    let mut read_ms = vec![f64::INFINITY; views];
    for round in 0..=frames.min(10) {
        for (view, best) in read_ms.iter_mut().enumerate() {
            let start = Instant::now();
            drawing.read(view)?;
            if round > 0 {
                *best = best.min(start.elapsed().as_secs_f64() * 1e3);
            }
        }
    }
    Ok(Frames {
        ms,
        read_ms: mean_over(read_ms.into_iter(), views),
    })
}

/// The fastest of some rounds, kernel by kernel and a view; then the mean over the views.
fn fastest(
    views: usize,
    rounds: usize,
    mut laps: impl FnMut(usize) -> Result<Laps, GpuError>,
) -> Result<Millis, Error> {
    let mut best = Fastest::of(views);
    for _ in 0..rounds.max(1) {
        for view in 0..views {
            best.add(view, laps(view)?, Duration::ZERO);
        }
    }
    Ok(best.mean().0)
}

/// Milliseconds per step, processor time over wall clock, and the number of steps without waiting
/// between them, of the fastest repetition; `run` does this many rounds over all views, and waits
/// once.
fn behind_one_another(
    steps: usize,
    views: usize,
    observer: &dyn Observer,
    mut run: impl FnMut(usize) -> Result<(), GpuError>,
) -> Result<(f64, f64, usize), Error> {
    let start = Instant::now();
    run(1)?;
    let once = start.elapsed().max(Duration::from_micros(1));
    let long = (LONG.as_secs_f64() / once.as_secs_f64()).ceil() as usize;
    let rounds = steps.max(long.min(MOST / views.max(1))).max(1);
    let count = rounds * views;
    let (mut best, mut busy) = (f64::INFINITY, 0.0);
    for _ in 0..REPEATS {
        check_stop(observer, "bench", false)?;
        let (wall, cpu) = (Instant::now(), ProcessTime::now());
        run(rounds)?;
        let (cpu, wall) = (cpu.elapsed().as_secs_f64(), wall.elapsed().as_secs_f64());
        if wall < best {
            (best, busy) = (wall, cpu / wall);
        }
    }
    Ok((best * 1e3 / count.max(1) as f64, busy, count))
}
