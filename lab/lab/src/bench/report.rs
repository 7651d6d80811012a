//! The results of a benchmark, and their form for people.

use super::table::{aligned, number, today};
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
    /// Kernels were timed by the GPU's own clock; else by waiting for it after each, which takes
    /// longer than short kernels.
    pub(super) own_clock: bool,
    /// Steps that were requested without waiting between them.
    pub(super) behind_one_another: usize,
    /// Frames a second when each is copied to the host, one after the other.
    pub(super) read_frames_per_s: f64,
    /// What training was expected to take on the GPU (`m4_kernels::plan::Plan`), bytes.
    pub(super) planned_bytes: u64,
    /// What its buffers took, with the bench's own, bytes.
    pub(super) in_use_bytes: u64,
    /// What the runtime had taken from the driver, bytes: it rarely gives any back, so that this is
    /// close to the peak.
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
        let gpu = self.gpu.as_ref().map_or_else(String::new, |gpu| {
            format!("{} ({}, {}, {}); ", gpu.name, gpu.kind, gpu.api, gpu.driver)
        });
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
    pub(super) kernel: String,
    /// Wall clock per step, fastest of all steps.
    pub(super) ms: f64,
    /// What [`Self::ns_per_item`] is counted in: splat (alive or touched), pair (looked at), pixel.
    pub(super) item: String,
    /// Nanoseconds of wall clock an item.
    pub(super) ns_per_item: f64,
    /// Useful evaluations per second, billions; of the blending kernels.
    pub(super) evaluations_g_per_s: Option<f64>,
    /// Compulsory traffic, bytes per step.
    pub(super) bytes: f64,
    pub(super) gb_per_s: f64,
    pub(super) bound_ms: f64,
    pub(super) bound: Bound,
    /// `ms / bound_ms`.
    pub(super) times_bound: f64,
}

/// A whole training step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StepRow {
    /// Wall clock of the fastest step; on a GPU the mean of many without waiting between them.
    pub(super) ms: f64,
    pub(super) per_s: f64,
    /// CPU time of all threads over wall clock times threads, over all timed steps: the rest was
    /// spent waiting. On a GPU over wall clock alone: the cost of submitting work.
    pub(super) busy: f64,
    /// Sum of the kernels' bounds.
    pub(super) bound_ms: f64,
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
    /// Splats that live at the instant, mean over the instants, as the next five.
    pub(super) alive: f64,
    /// Splats that reach the image.
    pub(super) visible: f64,
    /// Splats that changed a pixel.
    pub(super) touched: f64,
    /// Entries of all tile lists.
    pub(super) pairs: f64,
    /// Splats that change a pixel, mean over the pixels.
    pub(super) blends_per_pixel: f64,
    /// Share of the evaluated lanes that changed a pixel, 0..1.
    pub(super) useful_share: f64,
    /// Measured speed of memory for a working set as large as the step's, GB/s.
    pub(super) stream_gb_per_s: f64,
    /// Measured multiply-adds, billions of lanes a second.
    pub(super) multiply_add_g_per_s: f64,
    pub(super) kernels: Vec<KernelRow>,
    /// The training step.
    pub(super) step: StepRow,
    /// Drawing alone: wall clock of the fastest frame.
    pub(super) render_ms: f64,
    pub(super) frames_per_s: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) gpu: Option<GpuCase>,
}

/// What `minute4d-lab bench` measured.
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
        Self {
            format: "minute4d-bench".to_owned(),
            version: 1,
            date: today(),
            machine,
            steps,
            cases,
        }
    }

    /// The whole report: the machine, one row per case, then one table per case.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let mut text = format!(
            "# Bench, {}\n\n{}; fastest of {} steps a view{}\n\n",
            self.date,
            self.machine.line(),
            self.steps,
            if self.machine.gpu.is_some() {
                "; whole steps and frames without waiting between them"
            } else {
                ""
            },
        );
        text += &self.overview();
        for case in &self.cases {
            text += &format!("\n{}", case.to_markdown());
        }
        text
    }

    /// One row per case: milliseconds per kernel and per step.
    fn overview(&self) -> String {
        let names = self
            .cases
            .first()
            .into_iter()
            .flat_map(|case| case.kernels.iter().map(|k| k.kernel.as_str()));
        let head = ["scene", "splats", "size", "threads"]
            .into_iter()
            .chain(names);
        let head = head.chain(["step ms", "steps/s", "busy", "frames/s"]);
        let mut table: Vec<Vec<String>> = vec![head.map(str::to_owned).collect()];
        for case in &self.cases {
            let mut row = vec![
                case.scene.clone(),
                case.splats.to_string(),
                format!("{}x{}", case.width, case.height),
                case.gpu
                    .map_or_else(|| case.threads.to_string(), |_| "GPU".to_owned()),
            ];
            row.extend(case.kernels.iter().map(|k| millis(k.ms)));
            let s = &case.step;
            row.extend([
                millis(s.ms),
                format!("{:.1}", s.per_s),
                format!("{:.0} %", 100.0 * s.busy),
            ]);
            row.push(format!("{:.0}", case.frames_per_s));
            table.push(row);
        }
        aligned(&table)
    }
}

impl Case {
    fn to_markdown(&self) -> String {
        let place = match (&self.gpu, self.threads) {
            (Some(_), _) => "GPU".to_owned(),
            (None, 1) => "1 thread".to_owned(),
            (None, threads) => format!("{threads} threads"),
        };
        let mut text = format!(
            "## {} splats, {} x {}, {}, {place}\n\n",
            self.splats, self.width, self.height, self.scene,
        );
        text += &format!(
            "{:.0} alive, {:.0} in the image, {:.0} touched, {:.0} pairs; {:.1} blends a pixel, {:.0} % of the lanes \
             useful; memory {:.1} GB/s, multiply-adds {:.1} G/s\n\n",
            self.alive,
            self.visible,
            self.touched,
            self.pairs,
            self.blends_per_pixel,
            100.0 * self.useful_share,
            self.stream_gb_per_s,
            self.multiply_add_g_per_s,
        );
        let head = [
            "kernel", "ms", "ns/item", "item", "Geval/s", "MB", "GB/s", "bound ms", "bound by",
            "x bound",
        ];
        let mut table = vec![head.map(str::to_owned).to_vec()];
        table.extend(self.kernels.iter().map(kernel_row));
        let (step, dash) = (&self.step, || "-".to_owned());
        table.push(vec![
            "step".to_owned(),
            millis(step.ms),
            dash(),
            dash(),
            dash(),
            format!(
                "{:.1}",
                self.kernels.iter().map(|k| k.bytes).sum::<f64>() / 1e6
            ),
            dash(),
            millis(step.bound_ms),
            "all".to_owned(),
            format!("{:.1}", step.ms / step.bound_ms.max(1e-9)),
        ]);
        text += &aligned(&table);
        if let Some(gpu) = &self.gpu {
            text += &gpu.to_markdown();
        }
        text
    }
}

impl GpuCase {
    fn to_markdown(self) -> String {
        let mb = |bytes: u64| bytes as f64 / 1e6;
        format!(
            "\nkernels timed by {}; {} behind one another; memory {:.0} MB planned, {:.0} MB in use, {:.0} MB taken from \
             the driver; {:.0} frames/s where each is copied to the host\n",
            if self.own_clock {
                "the GPU's own clock"
            } else {
                "waiting for the GPU after each"
            },
            self.behind_one_another,
            mb(self.planned_bytes),
            mb(self.in_use_bytes),
            mb(self.reserved_bytes),
            self.read_frames_per_s,
        )
    }
}

fn kernel_row(k: &KernelRow) -> Vec<String> {
    vec![
        k.kernel.clone(),
        millis(k.ms),
        format!("{:.1}", k.ns_per_item),
        k.item.clone(),
        number(k.evaluations_g_per_s, 2),
        format!("{:.1}", k.bytes / 1e6),
        format!("{:.1}", k.gb_per_s),
        format!("{:.3}", k.bound_ms),
        k.bound.name().to_owned(),
        format!("{:.1}", k.times_bound),
    ]
}

/// To a hundredth, below a millisecond to a thousandth.
fn millis(ms: f64) -> String {
    if ms < 1.0 {
        format!("{ms:.3}")
    } else {
        format!("{ms:.2}")
    }
}
