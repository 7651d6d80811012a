//! The photometric loss `(1 - lambda) L1 + lambda (1 - SSIM)` and its gradient
//! (docs/spec/optimiser.md 3).
//!
//! Both terms are means over all pixels and channels. SSIM (Wang et al. 2004): a Gaussian window of
//! [`WINDOW`] taps and [`WINDOW_SD`] pixels, applied along rows and columns, *zero padded* (images
//! may be smaller than the window), each channel alone, dynamic range 1. The gradient of `|d|` at
//! `d = 0` is 0.

mod buffers;
pub mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod reference;
mod segment;

/// Taps of the window.
pub const WINDOW: usize = 11;
/// Standard deviation of the window, pixels.
pub const WINDOW_SD: f64 = 1.5;
/// Keeps the luminance term finite: `(0.01 L)^2` with `L = 1`.
pub const SSIM_C1: f64 = 0.01 * 0.01;
/// Keeps the contrast term finite: `(0.03 L)^2` with `L = 1`.
pub const SSIM_C2: f64 = 0.03 * 0.03;

/// The taps of the window: they add up to 1.
pub fn window() -> [f64; WINDOW] {
    let mut taps = [0.0; WINDOW];
    for (k, tap) in taps.iter_mut().enumerate() {
        let x = (k as f64 - (WINDOW / 2) as f64) / WINDOW_SD;
        *tap = (-0.5 * x * x).exp();
    }
    let sum: f64 = taps.iter().sum();
    taps.map(|tap| tap / sum)
}
