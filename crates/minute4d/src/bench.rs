//! How long the kernels take on this machine.

use crate::{Error, Observer};
use m4_kernels::SimdLevel;
use m4_kernels::bench::{BenchConfig, BenchReport};
use serde::Serialize;

/// Times of several sizes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bench {
    /// Columns of the image, pixels.
    pub width: usize,
    /// Rows of the image, pixels.
    pub height: usize,
    /// Threads used.
    pub threads: usize,
    /// Vector instructions used.
    pub simd: String,
    /// Steps timed; the fastest of each kernel counts.
    pub steps: usize,
    /// One a size.
    pub rows: Vec<BenchRow>,
}

/// Milliseconds a step of one size.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BenchRow {
    /// Splats in the scene.
    pub splats: usize,
    /// Splats that reached the image.
    pub visible: usize,
    /// Entries of the tile lists.
    pub pairs: usize,
    /// Slice, project and shade.
    pub project_ms: f64,
    /// Depth order and tile lists.
    pub bin_ms: f64,
    /// Tile lists to the image.
    pub blend_ms: f64,
    /// L1 + SSIM and its gradient.
    pub photo_ms: f64,
    /// Image gradient to ellipse gradients.
    pub blend_backward_ms: f64,
    /// Ellipse gradients to parameter gradients.
    pub project_backward_ms: f64,
    /// The optimiser.
    pub adam_ms: f64,
    /// All of the above, in one step.
    pub step_ms: f64,
}

impl BenchRow {
    fn new(splats: usize, report: &BenchReport) -> Self {
        Self {
            splats,
            visible: report.visible,
            pairs: report.pairs,
            project_ms: report.project_ms,
            bin_ms: report.bin_ms,
            blend_ms: report.blend_ms,
            photo_ms: report.photo_ms,
            blend_backward_ms: report.blend_backward_ms,
            project_backward_ms: report.project_backward_ms,
            adam_ms: report.adam_ms,
            step_ms: report.step_ms,
        }
    }
}

/// Times training steps on synthetic scenes of these sizes, at 480x360 pixels.
///
/// # Errors
///
/// [`Error::Simd`] if the instruction set asked for is not there, [`Error::Stopped`] on request.
pub fn run(splats: &[usize], steps: usize, observer: &dyn Observer) -> Result<Bench, Error> {
    let level = SimdLevel::detect()?;
    let config = BenchConfig {
        steps,
        ..BenchConfig::default()
    };
    let splats_total = splats.len();
    let mut rows = Vec::new();
    for (i, &splats) in splats.iter().enumerate() {
        observer.update("bench", i, splats_total, &format!("{splats} splats"));
        if observer.cancelled() {
            return Err(Error::Stopped {
                stage: "bench",
                saved: false,
            });
        }
        let config = BenchConfig { splats, ..config };
        let report = m4_kernels::bench::run(level, &config).map_err(|e| Error::Internal { what: e.to_string() })?;
        rows.push(BenchRow::new(splats, &report));
    }
    Ok(Bench {
        width: config.width,
        height: config.height,
        threads: rayon::current_num_threads(),
        simd: level.name().to_owned(),
        steps,
        rows,
    })
}
