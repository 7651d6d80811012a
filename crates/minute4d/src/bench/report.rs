//! The results of a benchmark, and their form for people.

use super::table::{aligned, today};
use m4_kernels::SimdLevel;
use serde::Serialize;

/// Where it was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Machine {
    pub(super) cpu: Option<String>,
    /// Cores that this process may use.
    pub(super) cores: usize,
    pub(super) simd: String,
    pub(super) platform: String,
    pub(super) minute4d: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) gpu: Option<GpuMachine>,
}

/// A GPU that kernels ran on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GpuMachine {
    pub(super) name: String,
    /// Discrete, integrated, virtual, software, other.
    pub(super) kind: String,
    /// Vulkan, Metal, DX12 or CUDA.
    pub(super) api: String,
    pub(super) driver: String,
}

/// What a case on a GPU has besides.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GpuCase {
    /// Steps that were requested without waiting between them.
    pub(super) behind_one_another: usize,
    /// What training was expected to take on the GPU (`m4_kernels::gpu::Plan`), bytes.
    pub(super) planned_bytes: u64,
    /// What its buffers took, with the bench's own, bytes.
    pub(super) in_use_bytes: u64,
    /// What the runtime had taken from the driver, bytes: it rarely gives any back, so that this is close to the peak.
    pub(super) reserved_bytes: u64,
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
            "{gpu}{}, {} cores, {}, {}; minute4d {}",
            self.cpu.as_deref().unwrap_or("unknown processor"),
            self.cores,
            self.simd,
            self.platform,
            self.minute4d,
        )
    }
}

/// One kernel of one case. Figures of a moving scene are means over its instants.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KernelRow {
    pub(super) kernel: String,
    /// Wall clock per step, fastest of all steps.
    pub(super) ms: f64,
}

/// A whole training step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StepRow {
    /// Wall clock of the fastest step; on a GPU the mean of many without waiting between them.
    pub(super) ms: f64,
    pub(super) per_s: f64,
    /// CPU time of all threads over wall clock times threads, over all timed steps: the rest was spent waiting. On a GPU over wall
    /// clock alone: the cost of submitting work.
    pub(super) busy: f64,
    /// Loss of the first and of the last step: they show that the steps do what they should.
    pub(super) loss: [f64; 2],
}

/// One scene at one size on some threads.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Case {
    /// `static` or `4d`.
    pub(super) scene: String,
    pub(super) splats: usize,
    pub(super) width: usize,
    pub(super) height: usize,
    /// Threads used; 1 on a GPU.
    pub(super) threads: usize,
    /// Splats that reach the image, mean over the instants.
    pub(super) visible: f64,
    /// Entries of all tile lists, mean over the instants.
    pub(super) pairs: f64,
    /// Of the processor; a GPU is timed as a whole.
    pub(super) kernels: Vec<KernelRow>,
    /// The training step.
    pub(super) step: StepRow,
    /// Drawing alone: wall clock of the fastest frame; on a GPU with its copy to the host.
    pub(super) render_ms: f64,
    pub(super) frames_per_s: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) gpu: Option<GpuCase>,
}

/// What `minute4d bench` measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BenchReport {
    pub(super) format: String,
    pub(super) version: u32,
    pub(super) date: String,
    pub(super) machine: Machine,
    /// Times that each view was stepped.
    pub(super) steps: usize,
    /// One per combination.
    pub(super) cases: Vec<Case>,
}

impl BenchReport {
    /// A report of today.
    pub(super) fn new(machine: Machine, steps: usize, cases: Vec<Case>) -> Self {
        Self { format: "minute4d-bench".to_owned(), version: 2, date: today(), machine, steps, cases }
    }

    /// The whole report: the machine, then one row per case: milliseconds per kernel and per step.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let on_gpu = self.machine.gpu.is_some();
        let kernels = self.cases.first().map_or(&[][..], |case| &case.kernels);
        let mut head = vec!["scene", "splats", "size", "threads", "visible", "pairs"];
        head.extend(kernels.iter().map(|k| k.kernel.as_str()));
        head.extend(["step ms", "steps/s", "busy", "frames/s"]);
        if on_gpu {
            head.extend(["planned MB", "in use MB", "taken MB"]);
        }
        let mut table = vec![head.into_iter().map(str::to_owned).collect()];
        table.extend(self.cases.iter().map(Case::row));
        format!(
            "# Bench, {}\n\n{}; fastest of {} steps a view{}\n\n{}",
            self.date,
            self.machine.line(),
            self.steps,
            if on_gpu { "; whole steps without waiting between them" } else { "" },
            aligned(&table),
        )
    }
}

impl Case {
    fn row(&self) -> Vec<String> {
        let mut row = vec![
            self.scene.clone(),
            self.splats.to_string(),
            format!("{}x{}", self.width, self.height),
            self.gpu.map_or_else(|| self.threads.to_string(), |_| "GPU".to_owned()),
            format!("{:.0}", self.visible),
            format!("{:.0}", self.pairs),
        ];
        row.extend(self.kernels.iter().map(|k| millis(k.ms)));
        let step = &self.step;
        row.extend([millis(step.ms), format!("{:.1}", step.per_s), format!("{:.0} %", 100.0 * step.busy)]);
        row.push(format!("{:.0}", self.frames_per_s));
        if let Some(gpu) = &self.gpu {
            let bytes = [gpu.planned_bytes, gpu.in_use_bytes, gpu.reserved_bytes];
            row.extend(bytes.map(|bytes| format!("{:.0}", bytes as f64 / 1e6)));
        }
        row
    }
}

/// To a hundredth, below a millisecond to a thousandth.
fn millis(ms: f64) -> String {
    if ms < 1.0 { format!("{ms:.3}") } else { format!("{ms:.2}") }
}
