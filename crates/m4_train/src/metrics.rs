//! The metrics of a running training.

use serde::{Deserialize, Serialize};

/// The state of a run after some iterations; one line of `metrics.jsonl`. Losses are means over the
/// iterations since the event before.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MetricsEvent {
    /// Steps taken.
    pub iteration: usize,
    /// Everything that is minimised.
    pub loss: f64,
    /// Mean absolute error of the training frames, colours 0..1.
    pub l1: f64,
    /// Mean structural similarity of the training frames.
    pub ssim: f64,
    /// PSNR of the frame rendered last, dB (colours clamped to 0..1).
    pub psnr: f64,
    /// Splats without time parameters.
    pub splats_static: usize,
    /// Splats with time parameters.
    pub splats_dynamic: usize,
    /// Splats that a step moved, mean.
    pub touched: f64,
    /// Seconds of training in this process.
    pub seconds: f64,
    /// Seconds of processor time of all threads of this process during those: what training costs
    /// however busy the machine is. 0 where the system does not count it.
    #[serde(default)]
    pub processor_seconds: f64,
}

/// Sums since the last event.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Totals {
    pub steps: usize,
    /// Frames rendered: as many per step as a batch has.
    pub frames: usize,
    pub loss: f64,
    pub l1: f64,
    pub ssim: f64,
    pub touched: usize,
}

/// PSNR of two images of one plane per channel, the first clamped to 0..1; 100 dB for equal ones.
pub(crate) fn psnr(rgb: &[Vec<f32>; 3], target: &[Vec<f32>; 3]) -> f64 {
    let (mut sum, mut count) = (0.0f64, 0usize);
    for (a, b) in rgb.iter().zip(target) {
        for (a, b) in a.iter().zip(b) {
            let d = f64::from(a.clamp(0.0, 1.0) - b);
            sum += d * d;
        }
        count += a.len();
    }
    (-10.0 * (sum / count.max(1) as f64).log10()).min(100.0)
}
