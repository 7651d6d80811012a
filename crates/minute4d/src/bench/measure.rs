//! Times one benchmark case.

use super::{BenchConfig, Bound, Case, GpuCase, KernelRow, StepRow};
use cpu_time::ProcessTime;
use m4_kernels::SimdLevel;
use m4_kernels::bench::{Bench, Counts, Kernel, PEAK_EVALUATIONS, Probe, SceneConfig, Times, Work};
use std::time::{Duration, Instant};

/// Least and most bytes that the probe of memory streams.
const PROBE_BYTES: (f64, f64) = (1e6, 256e6);
/// Operations of an evaluation on a GPU, forward and backward, counted by hand from the kernels: a multiply-add,
/// comparison or root is 1, an `exp` or division 4 (a quarter of the rate of multiply-adds, as devices have it).
const OPERATIONS: (f64, f64) = (24.0, 44.0);

/// Times a scene on the current pool of threads; `counts` has one entry per view.
pub(super) fn on_processor(
    level: SimdLevel,
    scene: &SceneConfig,
    counts: &[Counts],
    config: &BenchConfig,
    bench: &mut Bench,
) -> Case {
    let bytes: f64 = kernels(config).map(|kernel| mean_work(kernel, counts).bytes).sum();
    let probe = Probe::run(level, bytes.clamp(PROBE_BYTES.0, PROBE_BYTES.1) as usize);
    let steps = if config.render_only { None } else { Some(time_steps(bench, config.steps)) };
    let (render_ms, drawn) = time_frames(bench, config.steps);
    let timed =
        Timed { kernels: steps.as_ref().map_or(drawn, |steps| steps.0), step: steps.map(|steps| steps.1), render_ms };
    case(scene, counts, config, Some(level), &probe, timed, None)
}

/// What a clock said of a case.
pub(super) struct Timed {
    pub kernels: Millis,
    pub step: Option<Step>,
    pub render_ms: f64,
}

/// What a clock said of whole steps.
pub(super) struct Step {
    pub ms: f64,
    pub busy: f64,
    pub loss: [f64; 2],
}

/// The report of a case: on the processor with the instructions of `level`, or on a GPU.
pub(super) fn case(
    scene: &SceneConfig,
    counts: &[Counts],
    config: &BenchConfig,
    level: Option<SimdLevel>,
    probe: &Probe,
    timed: Timed,
    gpu: Option<GpuCase>,
) -> Case {
    let rows: Vec<KernelRow> = kernels(config)
        .map(|kernel| row(kernel, mean_work(kernel, counts), timed.kernels[index(kernel)], level, probe))
        .collect();
    let mean = |f: fn(&Counts) -> f64| mean_over(counts.iter().map(f), counts.len());
    let step = timed.step.map(|step| StepRow {
        ms: step.ms,
        per_s: 1e3 / step.ms,
        busy: step.busy,
        bound_ms: rows.iter().map(|r| r.bound_ms).sum(),
        loss: step.loss,
    });
    Case {
        scene: scene.kind.name().to_owned(),
        splats: scene.splats,
        width: scene.width,
        height: scene.height,
        sh_degree: scene.sh_degree,
        threads: if gpu.is_some() { 1 } else { rayon::current_num_threads() },
        alive: mean(|c| (c.alive[0] + c.alive[1]) as f64),
        visible: mean(|c| c.visible as f64),
        touched: mean(|c| (c.touched[0] + c.touched[1]) as f64),
        pairs: mean(|c| c.pairs as f64),
        blends_per_pixel: mean(|c| c.useful as f64 / (c.pixels as f64).max(1.0)),
        useful_share: match gpu {
            Some(_) => mean(|c| c.useful as f64 / ((c.used * GPU_TILE) as f64).max(1.0)),
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
const GPU_TILE: usize = 16 * 16;

fn kernels(config: &BenchConfig) -> impl Iterator<Item = Kernel> {
    let all = !config.render_only;
    Kernel::ALL.into_iter().filter(move |k| all || k.renders())
}

fn index(kernel: Kernel) -> usize {
    Kernel::ALL.iter().position(|&k| k == kernel).unwrap_or_default()
}

fn mean_work(kernel: Kernel, counts: &[Counts]) -> Work {
    let n = counts.len().max(1) as f64;
    counts.iter().map(|c| kernel.work(c)).fold(Work::default(), |sum, w| Work {
        bytes: sum.bytes + w.bytes / n,
        operations: sum.operations + w.operations / n,
        evaluations: sum.evaluations + w.evaluations / n,
        items: sum.items + w.items / n,
    })
}

/// Kernel by kernel, milliseconds.
pub(super) type Millis = [f64; Kernel::ALL.len()];

/// The fastest of some, a view; then the mean over the views.
fn time_steps(bench: &mut Bench, steps: usize) -> (Millis, Step) {
    let views = bench.views();
    let mut best = vec![([f64::INFINITY; Kernel::ALL.len()], f64::INFINITY); views];
    let mut loss = [0.0; 2];
    for (view, _) in best.iter().enumerate() {
        loss[0] += bench.step(view).loss / views as f64;
    }
    let (wall, cpu) = (Instant::now(), ProcessTime::now());
    for _ in 0..steps.max(1) {
        loss[1] = 0.0;
        for (view, (kernels, whole)) in best.iter_mut().enumerate() {
            let Times { kernels: now, step, loss: value } = bench.step(view);
            for (best, now) in kernels.iter_mut().zip(now) {
                *best = best.min(ms(now));
            }
            *whole = whole.min(ms(step));
            loss[1] += value / views as f64;
        }
    }
    let (cpu, wall) = (cpu.elapsed().as_secs_f64(), wall.elapsed().as_secs_f64());
    let step = Step {
        ms: mean_over(best.iter().map(|b| b.1), views),
        busy: cpu / (wall * rayon::current_num_threads() as f64),
        loss,
    };
    (std::array::from_fn(|k| mean_over(best.iter().map(|b| b.0[k]), views)), step)
}

/// Frames alone: milliseconds per frame and a kernel.
fn time_frames(bench: &mut Bench, frames: usize) -> (f64, Millis) {
    let views = bench.views();
    let mut best = vec![([f64::INFINITY; Kernel::ALL.len()], f64::INFINITY); views];
    for round in 0..=frames {
        for (view, (kernels, whole)) in best.iter_mut().enumerate() {
            let (now, frame) = bench.render(view);
            // the first round fills the memory of the renderer
            if round > 0 {
                for (best, now) in kernels.iter_mut().zip(now) {
                    *best = best.min(ms(now));
                }
                *whole = whole.min(ms(frame));
            }
        }
    }
    (mean_over(best.iter().map(|b| b.1), views), std::array::from_fn(|k| mean_over(best.iter().map(|b| b.0[k]), views)))
}

pub(super) fn mean_over(values: impl Iterator<Item = f64>, n: usize) -> f64 {
    values.sum::<f64>() / n.max(1) as f64
}

pub(super) fn ms(d: Duration) -> f64 {
    d.as_secs_f64() * 1e3
}

/// `level` is none on a GPU.
fn row(kernel: Kernel, mut work: Work, ms: f64, level: Option<SimdLevel>, probe: &Probe) -> KernelRow {
    let forward = kernel == Kernel::Blend;
    let evaluation = match level {
        Some(level) => {
            let peak = PEAK_EVALUATIONS
                .iter()
                .find(|p| p.level == level.name())
                .map(|p| if forward { p.forward } else { p.backward });
            peak.map_or(0.0, |peak| work.evaluations / (peak * rayon::current_num_threads() as f64))
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
    let (bound, seconds) =
        limits.into_iter().fold((Bound::Memory, 0.0), |best, now| if now.1 > best.1 { now } else { best });
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
