//! The SIMD twin of the photometric loss.

use crate::SimdLevel;
use m4_scene::ShapeError;

/// A picture to compare with, and what SSIM needs of it alone.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Target {
    width: usize,
    height: usize,
    rgb: [Vec<f32>; 3],
    /// Windowed mean of each channel.
    mean: [Vec<f32>; 3],
    /// Windowed variance of each channel.
    variance: [Vec<f32>; 3],
}

/// Buffers kept from frame to frame.
#[derive(Debug, Clone, Default)]
pub struct PhotoScratch {
    maps: [Vec<f32>; 9],
}

/// The loss and its parts.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PhotoLoss {
    /// Mean absolute difference.
    pub l1: f64,
    /// Mean structural similarity, 1 for equal pictures.
    pub ssim: f64,
    /// `(1 - lambda) l1 + lambda (1 - ssim)`.
    pub total: f64,
}

impl Target {
    /// Takes the planes of a picture, `[height][width]` each, 0..1.
    ///
    /// # Errors
    ///
    /// [`ShapeError`] if a plane does not hold `width * height` values.
    pub fn new(width: usize, height: usize, rgb: [Vec<f32>; 3]) -> Result<Self, ShapeError> {
        for plane in &rgb {
            ShapeError::check("target plane", width * height, plane.len())?;
        }
        Ok(Self {
            width,
            height,
            rgb,
            ..Self::default()
        })
    }

    /// Columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// The picture, one plane a channel.
    #[must_use]
    pub fn rgb(&self) -> &[Vec<f32>; 3] {
        &self.rgb
    }
}

/// The loss of `rgb` against `target` and, in `gradient`, its gradient with respect to `rgb`
/// (overwritten, resized as needed).
///
/// # Panics
///
/// If a plane of `rgb` does not hold as many values as the target.
pub fn loss(
    level: SimdLevel,
    target: &Target,
    rgb: &[Vec<f32>; 3],
    lambda: f32,
    scratch: &mut PhotoScratch,
    gradient: &mut [Vec<f32>; 3],
) -> PhotoLoss {
    let _ = (level, lambda, scratch);
    for (plane, g) in rgb.iter().zip(gradient) {
        assert_eq!(
            plane.len(),
            target.width * target.height,
            "loss: planes of the target's size"
        );
        g.resize(plane.len(), 0.0);
    }
    PhotoLoss::default()
}

/// The mean over the channels of `|rgb - target|`, `[height][width]` (the error map of paper eq. 6).
///
/// # Panics
///
/// If a plane of `rgb` does not hold as many values as the target.
pub fn error_map(level: SimdLevel, target: &Target, rgb: &[Vec<f32>; 3], out: &mut Vec<f32>) {
    let _ = level;
    let n = target.width * target.height;
    out.clear();
    out.extend((0..n).map(|i| {
        let sum: f32 = (0..3).map(|c| (rgb[c][i] - target.rgb[c][i]).abs()).sum();
        sum / 3.0
    }));
}
