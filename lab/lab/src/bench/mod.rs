//! Benchmarks of the kernels on this machine, compared with its limits.
//!
//! [`run`] times training steps and rendering on synthetic scenes ([`m4_kernels::bench`]); the
//! [`BenchReport`] is what the program prints. `docs/bench.md` explains every column.

#[cfg(feature = "gpu")]
mod gpu;
mod report;
mod table;

pub use report::{BenchReport, Bound, Case, GpuCase, KernelRow, Machine, StepRow};
pub use table::{aligned, number, today};

use cpu_time::ProcessTime;
use m4_kernels::bench::{
    Bench, Counts, PEAK_EVALUATIONS, Probe, SceneConfig, SceneKind, Times, Work,
};
use m4_kernels::{Kernel, SimdLevel};
use minute4d::device::DeviceChoice;
use minute4d::observer::check_stop;
use minute4d::{Error, Observer};
use minute4d_cli::run::with_threads;
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
        let all = minute4d_cli::run::threads();
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
/// [`Error::Internal`] if the system gives no threads; [`Error::Gpu`] if the GPU asked for is
/// missing, does not have or may not take the memory, or fails; [`Error::NoGpuSupport`] in a build
/// that cannot use any.
pub fn run(config: &BenchConfig, observer: &dyn Observer) -> Result<BenchReport, Error> {
    let level = SimdLevel::detect()?;
    let mut scenes = Vec::new();
    for &kind in &config.scenes {
        for &(width, height) in &config.sizes {
            scenes.extend(config.splats.iter().map(|&splats| SceneConfig {
                splats,
                width,
                height,
                kind,
            }));
        }
    }
    #[cfg(feature = "gpu")]
    if let Some(gpu) = gpu::open(config.device)? {
        let cases = each(&scenes, 1, observer, |scene| {
            Ok(vec![gpu::run(&gpu, level, scene, config, observer)?])
        })?;
        let machine = Machine {
            gpu: Some(gpu::machine(&gpu)),
            ..Machine::here(level, config.cpu.clone())
        };
        return Ok(BenchReport::new(machine, config.steps, cases));
    }
    #[cfg(not(feature = "gpu"))]
    if matches!(config.device, DeviceChoice::Gpu(_)) {
        return Err(Error::NoGpuSupport);
    }
    let cases = each(&scenes, config.threads.len(), observer, |scene| {
        let mut bench = Bench::new(level, scene).map_err(Error::internal)?;
        let counts: Vec<_> = (0..bench.views()).map(|view| bench.count(view)).collect();
        let mut cases = Vec::new();
        for &threads in &config.threads {
            check_stop(observer, "bench", false)?;
            cases.push(with_threads(Some(threads), || {
                on_processor(level, scene, &counts, config, &mut bench)
            })?);
        }
        Ok(cases)
    })?;
    Ok(BenchReport::new(
        Machine::here(level, config.cpu.clone()),
        config.steps,
        cases,
    ))
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
        let note = format!(
            "{} splats, {} x {}, {}",
            scene.splats,
            scene.width,
            scene.height,
            scene.kind.name()
        );
        observer.update("bench", cases.len(), total, &note);
        check_stop(observer, "bench", false)?;
        cases.extend(of(scene)?);
        observer.update("bench", cases.len(), total, &note);
    }
    Ok(cases)
}

/// Least and most bytes that the probe of memory streams.
const PROBE_BYTES: (f64, f64) = (1e6, 256e6);
/// Operations of an evaluation on a GPU, forward and backward, counted by hand from the kernels: a
/// multiply-add, comparison or root is 1, an `exp` or division 4 (a quarter of the rate of
/// multiply-adds, as devices have it).
const OPERATIONS: (f64, f64) = (24.0, 44.0);

/// Times a scene on the current pool of threads; `counts` has one entry per view.
fn on_processor(
    level: SimdLevel,
    scene: &SceneConfig,
    counts: &[Counts],
    config: &BenchConfig,
    bench: &mut Bench,
) -> Case {
    let bytes: f64 = Kernel::ALL
        .map(|kernel| mean_work(kernel, counts).bytes)
        .iter()
        .sum();
    let probe = Probe::run(level, bytes.clamp(PROBE_BYTES.0, PROBE_BYTES.1) as usize);
    let (kernels, step) = time_steps(bench, config.steps);
    let timed = Timed {
        kernels,
        step,
        render_ms: time_frames(bench, config.steps),
    };
    case(scene, counts, Some(level), &probe, timed, None)
}

/// What a clock said of a case.
struct Timed {
    pub kernels: Millis,
    pub step: Step,
    pub render_ms: f64,
}

/// What a clock said of whole steps.
struct Step {
    pub ms: f64,
    pub busy: f64,
    pub loss: [f64; 2],
}

/// The report of a case: on the processor with the instructions of `level`, or on a GPU.
fn case(
    scene: &SceneConfig,
    counts: &[Counts],
    level: Option<SimdLevel>,
    probe: &Probe,
    timed: Timed,
    gpu: Option<GpuCase>,
) -> Case {
    let kernels = Kernel::ALL.into_iter().zip(timed.kernels);
    let rows: Vec<KernelRow> = kernels
        .map(|(kernel, ms)| row(kernel, mean_work(kernel, counts), ms, level, probe))
        .collect();
    let mean = |f: fn(&Counts) -> f64| mean_over(counts.iter().map(f), counts.len());
    let step = StepRow {
        ms: timed.step.ms,
        per_s: 1e3 / timed.step.ms,
        busy: timed.step.busy,
        bound_ms: rows.iter().map(|r| r.bound_ms).sum(),
        loss: timed.step.loss,
    };
    Case {
        scene: scene.kind.name().to_owned(),
        splats: scene.splats,
        width: scene.width,
        height: scene.height,
        threads: if gpu.is_some() {
            1
        } else {
            minute4d_cli::run::threads()
        },
        alive: mean(|c| (c.alive[0] + c.alive[1]) as f64),
        visible: mean(|c| c.visible as f64),
        touched: mean(|c| (c.touched[0] + c.touched[1]) as f64),
        pairs: mean(|c| c.pairs as f64),
        blends_per_pixel: mean(|c| c.useful as f64 / (c.pixels as f64).max(1.0)),
        useful_share: match gpu {
            Some(_) => mean(|c| c.useful as f64 / ((c.used * GPU_TILE_PIXELS) as f64).max(1.0)),
            None => mean(Counts::useful_share),
        },
        stream_gb_per_s: probe.bytes_per_s / 1e9,
        multiply_add_g_per_s: probe.operations_per_s / 1e9,
        kernels: rows,
        step,
        render_ms: timed.render_ms,
        frames_per_s: 1e3 / timed.render_ms,
        gpu,
    }
}

/// Pixels of a tile on a GPU.
const GPU_TILE_PIXELS: usize = 8 * 8;

fn mean_work(kernel: Kernel, counts: &[Counts]) -> Work {
    let n = counts.len().max(1) as f64;
    counts
        .iter()
        .map(|c| kernel.work(c))
        .fold(Work::default(), |sum, w| Work {
            bytes: sum.bytes + w.bytes / n,
            operations: sum.operations + w.operations / n,
            evaluations: sum.evaluations + w.evaluations / n,
            items: sum.items + w.items / n,
        })
}

/// Kernel by kernel, milliseconds.
type Millis = [f64; Kernel::ALL.len()];

/// The fastest times of each view, milliseconds: kernel by kernel, and of the whole.
struct Fastest(Vec<(Millis, f64)>);

impl Fastest {
    fn of(views: usize) -> Self {
        Self(vec![
            ([f64::INFINITY; Kernel::ALL.len()], f64::INFINITY);
            views
        ])
    }

    fn add(&mut self, view: usize, kernels: [Duration; Kernel::ALL.len()], whole: Duration) {
        let (best, best_whole) = &mut self.0[view];
        for (best, now) in best.iter_mut().zip(kernels) {
            *best = best.min(ms(now));
        }
        *best_whole = best_whole.min(ms(whole));
    }

    /// Means over the views.
    fn mean(&self) -> (Millis, f64) {
        let mean =
            |of: &dyn Fn(&(Millis, f64)) -> f64| mean_over(self.0.iter().map(of), self.0.len());
        (
            std::array::from_fn(|k| mean(&|best| best.0[k])),
            mean(&|best| best.1),
        )
    }
}

/// The fastest steps of each view, as means over the views.
fn time_steps(bench: &mut Bench, steps: usize) -> (Millis, Step) {
    let views = bench.views();
    let mut best = Fastest::of(views);
    let mut loss = [0.0; 2];
    for view in 0..views {
        loss[0] += bench.step(view).loss / views as f64;
    }
    let (wall, cpu) = (Instant::now(), ProcessTime::now());
    for _ in 0..steps.max(1) {
        loss[1] = 0.0;
        for view in 0..views {
            let Times {
                kernels,
                step,
                loss: value,
            } = bench.step(view);
            best.add(view, kernels, step);
            loss[1] += value / views as f64;
        }
    }
    let (cpu, wall) = (cpu.elapsed().as_secs_f64(), wall.elapsed().as_secs_f64());
    let (kernels, ms) = best.mean();
    (
        kernels,
        Step {
            ms,
            busy: cpu / (wall * minute4d_cli::run::threads() as f64),
            loss,
        },
    )
}

/// Milliseconds of the fastest frame of each view, as the mean over the views.
fn time_frames(bench: &mut Bench, frames: usize) -> f64 {
    let mut best = vec![f64::INFINITY; bench.views()];
    for round in 0..=frames {
        for (view, best) in best.iter_mut().enumerate() {
            let (_, frame) = bench.render(view);
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

/// `level` is none on a GPU.
fn row(
    kernel: Kernel,
    mut work: Work,
    ms: f64,
    level: Option<SimdLevel>,
    probe: &Probe,
) -> KernelRow {
    let forward = kernel == Kernel::Blend;
    let evaluation = match level {
        Some(level) => {
            let peak = PEAK_EVALUATIONS
                .iter()
                .find(|p| p.level == level.name())
                .map(|p| if forward { p.forward } else { p.backward });
            peak.map_or(0.0, |peak| {
                work.evaluations / (peak * minute4d_cli::run::threads() as f64)
            })
        }
        None => {
            work.operations += work.evaluations * if forward { OPERATIONS.0 } else { OPERATIONS.1 };
            0.0
        }
    };
    let limits = [
        (Bound::Memory, work.bytes / probe.bytes_per_s),
        (Bound::Arithmetic, work.operations / probe.operations_per_s),
        (Bound::Evaluation, evaluation),
    ];
    let (bound, seconds) = limits.into_iter().fold((Bound::Memory, 0.0), |best, now| {
        if now.1 > best.1 { now } else { best }
    });
    let (bound_ms, seconds) = (seconds * 1e3, (ms * 1e-3).max(1e-9));
    KernelRow {
        kernel: kernel.name().to_owned(),
        ms,
        item: kernel.item().to_owned(),
        ns_per_item: ms * 1e6 / work.items.max(1.0),
        evaluations_g_per_s: (work.evaluations > 0.0).then(|| work.evaluations / seconds / 1e9),
        bytes: work.bytes,
        gb_per_s: work.bytes / seconds / 1e9,
        bound_ms,
        bound,
        times_bound: ms / bound_ms.max(1e-9),
    }
}
