//! Benchmarks of the kernels on this machine.
//!
//! [`run`] times training steps and rendering on synthetic scenes ([`m4_kernels::bench`]); the
//! [`BenchReport`] is what the program prints. `docs/bench.md` explains every column.

#[cfg(feature = "gpu")]
mod gpu;
mod report;
mod table;

pub use report::{BenchReport, Case, GpuCase, GpuMachine, KernelRow, Machine, StepRow};
pub(crate) use table::{aligned, number, today};

use crate::device::DeviceChoice;
use crate::stage::check_stop;
use crate::{Error, Observer, with_threads};
use cpu_time::ProcessTime;
use m4_kernels::bench::{Bench, Kernel, SceneConfig, SceneKind, Times};
use m4_kernels::{FrameStats, SimdLevel};
use std::time::{Duration, Instant};

/// What to time: every combination of the lists.
#[derive(Debug, Clone, PartialEq)]
pub struct BenchConfig {
    /// Gaussians in the scene.
    pub splats: Vec<usize>,
    /// Columns and rows of the image.
    pub sizes: Vec<(usize, usize)>,
    /// Static or moving.
    pub scenes: Vec<SceneKind>,
    /// Threads.
    pub threads: Vec<usize>,
    /// Times that each view is stepped; the fastest counts, kernel by kernel.
    pub steps: usize,
    /// Where to run; on a GPU threads do not matter.
    pub device: DeviceChoice,
    /// What a GPU may be made to hold, megabytes; no limit where there is none.
    pub max_vram_mb: Option<usize>,
    /// Name of the processor, for the report.
    pub cpu: Option<String>,
}

impl Default for BenchConfig {
    /// Three numbers of splats, two sizes, static and moving, one thread and all threads.
    fn default() -> Self {
        let all = rayon::current_num_threads();
        Self {
            splats: vec![20_000, 100_000, 300_000],
            sizes: vec![(480, 360), (960, 720)],
            scenes: vec![SceneKind::Static, SceneKind::FourD],
            threads: if all > 1 { vec![1, all] } else { vec![1] },
            steps: 15,
            device: DeviceChoice::Cpu,
            max_vram_mb: None,
            cpu: None,
        }
    }
}

/// Times every case of `config`.
///
/// # Errors
///
/// [`Error::Simd`] if the instruction set asked for is missing, [`Error::Stopped`] on request,
/// [`Error::Internal`] if the system gives no threads; [`Error::Gpu`] if the GPU asked for is missing, does not have or may
/// not take the memory, or fails; [`Error::NoGpuSupport`] in a build that cannot use any.
pub fn run(config: &BenchConfig, observer: &dyn Observer) -> Result<BenchReport, Error> {
    let level = SimdLevel::detect()?;
    let mut scenes = Vec::new();
    for &kind in &config.scenes {
        for &(width, height) in &config.sizes {
            scenes.extend(config.splats.iter().map(|&splats| SceneConfig { splats, width, height, kind }));
        }
    }
    #[cfg(feature = "gpu")]
    if let Some(gpu) = gpu::open(config.device)? {
        let cases = each(&scenes, 1, observer, |scene| Ok(vec![gpu::run(&gpu, level, scene, config, observer)?]))?;
        let machine = Machine { gpu: Some(gpu::machine(&gpu)), ..Machine::here(level, config.cpu.clone()) };
        return Ok(BenchReport::new(machine, config.steps, cases));
    }
    #[cfg(not(feature = "gpu"))]
    if matches!(config.device, DeviceChoice::Gpu(_)) {
        return Err(Error::NoGpuSupport);
    }
    let cases = each(&scenes, config.threads.len(), observer, |scene| {
        let mut bench = Bench::new(level, scene).map_err(|e| Error::Internal { what: e.to_string() })?;
        let counts = count(&mut bench);
        let mut cases = Vec::new();
        for &threads in &config.threads {
            check_stop(observer, "bench", false)?;
            cases.push(with_threads(Some(threads), || on_processor(scene, &counts, config, &mut bench))?);
        }
        Ok(cases)
    })?;
    Ok(BenchReport::new(Machine::here(level, config.cpu.clone()), config.steps, cases))
}

/// Runs the cases of every scene with progress; each scene has this many cases.
fn each(
    scenes: &[SceneConfig],
    cases_each: usize,
    observer: &dyn Observer,
    mut of: impl FnMut(&SceneConfig) -> Result<Vec<Case>, Error>,
) -> Result<Vec<Case>, Error> {
    let total = scenes.len() * cases_each;
    let mut cases = Vec::new();
    for scene in scenes {
        let note = format!("{} splats, {} x {}, {}", scene.splats, scene.width, scene.height, scene.kind.name());
        observer.update("bench", cases.len(), total, &note);
        check_stop(observer, "bench", false)?;
        cases.extend(of(scene)?);
        observer.update("bench", cases.len(), total, &note);
    }
    Ok(cases)
}

/// How much work each view is.
fn count(bench: &mut Bench) -> Vec<FrameStats> {
    let views = 0..bench.views();
    let one = |view| {
        bench.render(view);
        bench.stats()
    };
    views.map(one).collect()
}

/// Times a scene on the current pool of threads; `counts` has one entry per view.
fn on_processor(scene: &SceneConfig, counts: &[FrameStats], config: &BenchConfig, bench: &mut Bench) -> Case {
    let (kernels, step) = time_steps(bench, config.steps);
    case(scene, counts, kernels, step, time_frames(bench, config.steps), None)
}

/// The report of a case: on the processor, or on a GPU.
fn case(
    scene: &SceneConfig,
    counts: &[FrameStats],
    kernels: Vec<KernelRow>,
    step: StepRow,
    render_ms: f64,
    gpu: Option<GpuCase>,
) -> Case {
    let mean = |f: fn(&FrameStats) -> usize| mean_over(counts.iter().map(|c| f(c) as f64), counts.len());
    Case {
        scene: scene.kind.name().to_owned(),
        splats: scene.splats,
        width: scene.width,
        height: scene.height,
        threads: if gpu.is_some() { 1 } else { rayon::current_num_threads() },
        visible: mean(|c| c.visible),
        pairs: mean(|c| c.pairs),
        kernels,
        step,
        render_ms,
        frames_per_s: 1e3 / render_ms,
        gpu,
    }
}

/// The fastest steps of each view, kernel by kernel and as a whole, as means over the views.
fn time_steps(bench: &mut Bench, steps: usize) -> (Vec<KernelRow>, StepRow) {
    const KERNELS: usize = Kernel::ALL.len();
    let views = bench.views();
    let mut best = vec![[f64::INFINITY; KERNELS + 1]; views];
    let mut loss = [0.0; 2];
    for view in 0..views {
        loss[0] += bench.step(view).loss / views as f64;
    }
    let (wall, cpu) = (Instant::now(), ProcessTime::now());
    for _ in 0..steps.max(1) {
        loss[1] = 0.0;
        for (view, best) in best.iter_mut().enumerate() {
            let Times { kernels, step, loss: value } = bench.step(view);
            for (best, now) in best.iter_mut().zip(kernels.into_iter().chain([step])) {
                *best = best.min(ms(now));
            }
            loss[1] += value / views as f64;
        }
    }
    let (cpu, wall) = (cpu.elapsed().as_secs_f64(), wall.elapsed().as_secs_f64());
    let mean = |k: usize| mean_over(best.iter().map(|best| best[k]), views);
    let rows = Kernel::ALL.iter().enumerate();
    let rows = rows.map(|(k, kernel)| KernelRow { kernel: kernel.name().to_owned(), ms: mean(k) }).collect();
    let (ms, busy) = (mean(KERNELS), cpu / (wall * rayon::current_num_threads() as f64));
    (rows, StepRow { ms, per_s: 1e3 / ms, busy, loss })
}

/// Milliseconds of the fastest frame of each view, as the mean over the views.
fn time_frames(bench: &mut Bench, frames: usize) -> f64 {
    let mut best = vec![f64::INFINITY; bench.views()];
    for round in 0..=frames {
        for (view, best) in best.iter_mut().enumerate() {
            let frame = bench.render(view);
            // the first round fills the memory of the renderer
            if round > 0 {
                *best = best.min(ms(frame));
            }
        }
    }
    mean_over(best.iter().copied(), best.len())
}

fn mean_over(values: impl Iterator<Item = f64>, n: usize) -> f64 {
    values.sum::<f64>() / n.max(1) as f64
}

fn ms(d: Duration) -> f64 {
    d.as_secs_f64() * 1e3
}
