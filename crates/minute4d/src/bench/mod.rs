//! Benchmarks of the kernels on this machine, compared with its limits.
//!
//! [`run`] times training steps and rendering on synthetic scenes ([`m4_kernels::bench`]); the
//! [`BenchReport`] is what the program prints, saves and compares. `docs/bench.md` explains every column.

#[cfg(feature = "gpu")]
mod gpu;
mod measure;
mod memory;
mod report;
mod table;

pub use memory::{MemoryCase, MemoryConfig, MemoryReport, memory};
pub use report::{BenchReport, Bound, Case, GpuCase, GpuMachine, KernelRow, Machine, StepRow};
pub use table::{SavedReport, save};
pub(crate) use table::{aligned, today};

use crate::device::DeviceChoice;
use crate::{Error, Observer, with_threads};
use m4_kernels::SimdLevel;
use m4_kernels::bench::{Bench, SceneConfig, SceneKind};

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
    /// Degree of the spatial harmonics of the colour, 0..=3.
    pub sh_degree: usize,
    /// Draw alone, without the rest of a training step.
    pub render_only: bool,
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
            sh_degree: 0,
            render_only: false,
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
            scenes.extend(config.splats.iter().map(|&splats| SceneConfig {
                splats,
                width,
                height,
                sh_degree: config.sh_degree,
                kind,
            }));
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
        let counts: Vec<_> = (0..bench.views()).map(|view| bench.count(view)).collect();
        let mut cases = Vec::new();
        for &threads in &config.threads {
            if observer.cancelled() {
                return Err(stopped());
            }
            cases.push(with_threads(Some(threads), || {
                measure::on_processor(level, scene, &counts, config, &mut bench)
            })?);
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
        if observer.cancelled() {
            return Err(stopped());
        }
        cases.extend(of(scene)?);
        observer.update("bench", cases.len(), total, &note);
    }
    Ok(cases)
}

fn stopped() -> Error {
    Error::Stopped { stage: "bench", saved: false }
}
