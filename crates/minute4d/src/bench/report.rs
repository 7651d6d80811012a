//! The results of a benchmark.

use super::table;
use m4_kernels::SimdLevel;
use serde::Serialize;

/// `format` of a report.
const FORMAT: &str = "minute4d-bench";
/// Its version.
const VERSION: u32 = 1;

/// Where it was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Machine {
    /// Name of the processor, where the system tells.
    pub cpu: Option<String>,
    /// Cores that this process may use.
    pub cores: usize,
    /// Vector instructions used.
    pub simd: String,
    /// Architecture and system.
    pub platform: String,
    /// Release of the program.
    pub minute4d: String,
    /// The commit of the source folder that the program was started in, `-dirty` with changes; none elsewhere.
    pub commit: Option<String>,
    /// The GPU that kernels ran on, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gpu: Option<GpuMachine>,
}

/// A GPU that kernels ran on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GpuMachine {
    /// The name that the driver reports.
    pub name: String,
    /// Discrete, integrated, virtual, software, other.
    pub kind: String,
    /// Vulkan, Metal, DX12 or CUDA.
    pub api: String,
    /// Name and version of the driver, as it says.
    pub driver: String,
}

/// What a case on a GPU has besides.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GpuCase {
    /// Kernels were timed by the GPU's own clock; else by waiting for it after each, which takes longer than short kernels.
    pub own_clock: bool,
    /// Steps (or frames, when drawing alone was timed) that were asked for without waiting between them.
    pub behind_one_another: usize,
    /// Frames a second when each is copied to the host, one after the other.
    pub read_frames_per_s: f64,
    /// What training was expected to take on the GPU (`m4_kernels::gpu::Plan`), bytes.
    pub planned_bytes: u64,
    /// What its buffers took, with the bench's own, bytes.
    pub in_use_bytes: u64,
    /// What the runtime had taken from the driver, bytes: it rarely gives any back, so that this is close to the peak.
    pub reserved_bytes: u64,
}

impl Machine {
    /// This one.
    #[must_use]
    pub fn here(level: SimdLevel, cpu: Option<String>) -> Self {
        Self {
            cpu,
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            simd: level.name().to_owned(),
            platform: format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS),
            minute4d: env!("CARGO_PKG_VERSION").to_owned(),
            commit: table::commit(),
            gpu: None,
        }
    }

    /// As one line.
    #[must_use]
    pub fn line(&self) -> String {
        let gpu = self
            .gpu
            .as_ref()
            .map_or_else(String::new, |gpu| format!("{} ({}, {}, {}); ", gpu.name, gpu.kind, gpu.api, gpu.driver));
        format!(
            "{gpu}{}, {} cores, {}, {}; minute4d {}{}",
            self.cpu.as_deref().unwrap_or("unknown processor"),
            self.cores,
            self.simd,
            self.platform,
            self.minute4d,
            self.commit.as_ref().map_or_else(String::new, |c| format!(" at {c}")),
        )
    }
}

/// What limits a kernel whose time cannot be shorter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Bound {
    /// Compulsory traffic at the speed at which this machine streams a working set of that size.
    Memory,
    /// Operations of the definition at this machine's rate of multiply-adds.
    Arithmetic,
    /// Useful evaluations at the peak rate of the blending loop
    /// ([`m4_kernels::bench::PEAK_EVALUATIONS`]).
    Evaluation,
}

impl Bound {
    /// Returns the name in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Memory => "memory",
            Self::Arithmetic => "arithmetic",
            Self::Evaluation => "evaluation",
        }
    }
}

/// One kernel of one case. Figures of a moving scene are means over its instants.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KernelRow {
    /// Its name.
    pub kernel: String,
    /// Wall clock per step, fastest of all steps.
    pub ms: f64,
    /// What [`Self::ns_per_item`] is counted in: splat (alive or touched), pair (looked at), pixel.
    pub item: String,
    /// Nanoseconds of wall clock an item.
    pub ns_per_item: f64,
    /// Useful evaluations per second, billions; of the blending kernels.
    pub evaluations_g_per_s: Option<f64>,
    /// Compulsory traffic, bytes per step.
    pub bytes: f64,
    /// That traffic over that time, GB/s.
    pub gb_per_s: f64,
    /// The time that it cannot beat.
    pub bound_ms: f64,
    /// What decides that time.
    pub bound: Bound,
    /// `ms / bound_ms`.
    pub times_bound: f64,
}

/// A whole training step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StepRow {
    /// Wall clock of the fastest step; on a GPU the mean of many without waiting between them.
    pub ms: f64,
    /// `1000 / ms`.
    pub per_s: f64,
    /// CPU time of all threads over wall clock times threads, over all timed steps: what is missing to 1
    /// was spent waiting (or the system gave the time to another program). On a GPU over wall clock alone: what giving
    /// orders costs the host.
    pub busy: f64,
    /// Sum of the kernels' bounds.
    pub bound_ms: f64,
    /// Loss of the first and of the last step: they show that the steps do what they should.
    pub loss: [f64; 2],
}

/// One scene at one size on some threads.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Case {
    /// `static` or `4d`.
    pub scene: String,
    /// Splats in it.
    pub splats: usize,
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// Degree of the spatial harmonics.
    pub sh_degree: usize,
    /// Threads used; 1 on a GPU.
    pub threads: usize,
    /// Splats that live at the instant, mean over the instants, as the next five.
    pub alive: f64,
    /// Splats that reach the image.
    pub visible: f64,
    /// Splats that changed a pixel.
    pub touched: f64,
    /// Entries of all tile lists.
    pub pairs: f64,
    /// Splats that change a pixel, mean over the pixels.
    pub blends_per_pixel: f64,
    /// Share of the evaluated lanes that changed a pixel, 0..1.
    pub useful_share: f64,
    /// Measured speed of memory for a working set as large as the step's, GB/s.
    pub stream_gb_per_s: f64,
    /// Measured multiply-adds, billions of lanes a second.
    pub multiply_add_g_per_s: f64,
    /// Kernels that were timed.
    pub kernels: Vec<KernelRow>,
    /// The training step; none when drawing alone was timed.
    pub step: Option<StepRow>,
    /// Drawing alone: wall clock of the fastest frame.
    pub render_ms: f64,
    /// `1000 / render_ms`.
    pub frames_per_s: f64,
    /// On a GPU.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gpu: Option<GpuCase>,
}

/// What `minute4d bench` measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BenchReport {
    /// `minute4d-bench`.
    pub format: String,
    /// Of the format.
    pub version: u32,
    /// Day, UTC, `YYYY-MM-DD`.
    pub date: String,
    /// Where.
    pub machine: Machine,
    /// Times that each view was stepped.
    pub steps: usize,
    /// One per combination.
    pub cases: Vec<Case>,
}

impl BenchReport {
    /// A report of today.
    pub(super) fn new(machine: Machine, steps: usize, cases: Vec<Case>) -> Self {
        Self { format: FORMAT.to_owned(), version: VERSION, date: table::today(), machine, steps, cases }
    }
}
