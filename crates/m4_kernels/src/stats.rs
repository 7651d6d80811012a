//! Statistics of training steps.

use crate::CameraGradient;

/// What training steps found since the last time that they were asked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StepStats {
    /// Steps; the rest is unspecified where there were none.
    pub steps: usize,
    /// Frames rendered: as many per step as a batch has.
    pub frames: usize,
    /// Mean of the absolute differences over channels, pixels and frames; not finite if an image was not.
    pub l1: f64,
    /// Mean structural similarity.
    pub ssim: f64,
    /// PSNR of the frame rendered last, dB, colours clamped to 0..1, at most 100; NaN where it was not measured.
    pub psnr: f64,
    /// Splats that a step moved, mean.
    pub touched: f64,
    /// Gradients of the cameras that were requested, in the order of the views, each with the number of its frame.
    pub cameras: Vec<(usize, CameraGradient)>,
    /// Gradients of the exposures that were requested, likewise: rows of the matrix, each followed by its offset.
    pub exposures: Vec<(usize, [f64; 12])>,
    /// No step moved a parameter to NaN or infinity.
    pub splats_are_finite: bool,
}
