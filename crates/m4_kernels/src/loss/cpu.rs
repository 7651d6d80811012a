//! The SIMD version: each channel is divided into fixed segments of rows, which are tasks.

use super::segment::{self, Buffers, Segment};
pub use super::target::{Target, TargetPlanes};
use crate::{SimdLevel, simd::dispatch};
use rayon::prelude::*;

/// Rows a task, at most: the blurs of a task look twice five rows beyond its own, so short ones cost.
const SEGMENT_ROWS: usize = 192;
/// Rows a task of the error map.
const ERROR_ROWS: usize = 16;

/// Buffers kept from frame to frame.
#[derive(Debug, Clone, Default)]
pub struct LossScratch {
    /// One per segment.
    buffers: Vec<Buffers>,
}

/// The loss and its parts.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LossTerms {
    /// Mean absolute difference.
    pub l1: f64,
    /// Mean structural similarity, 1 for equal images.
    pub ssim: f64,
    /// `(1 - lambda) l1 + lambda (1 - ssim)`.
    pub total: f64,
}

/// The loss of `rgb` against `target` and, in `gradient`, its gradient with respect to `rgb`
/// (overwritten, resized as needed). Of an image without pixels both are 0.
///
/// # Panics
///
/// If a plane of `rgb` does not hold as many values as the target.
pub fn loss(
    level: SimdLevel,
    target: &Target,
    rgb: &[Vec<f32>; 3],
    lambda: f32,
    scratch: &mut LossScratch,
    gradient: &mut [Vec<f32>; 3],
) -> LossTerms {
    let (width, height) = (target.width(), target.height());
    let pixels = width * height;
    for plane in rgb {
        assert_eq!(plane.len(), pixels, "loss: planes of the target's size");
    }
    for plane in gradient.iter_mut() {
        plane.resize(pixels, 0.0);
    }
    if pixels == 0 {
        return LossTerms::default();
    }
    let (count, lambda) = ((3 * pixels) as f64, f64::from(lambda));
    let factors = [(1.0 - lambda) / count, -lambda / count].map(|f| f as f32);
    let rows = height.div_ceil(height.div_ceil(SEGMENT_ROWS));
    let tasks: Vec<_> = gradient
        .iter_mut()
        .enumerate()
        .flat_map(|(channel, plane)| {
            let parts = plane.chunks_mut(rows * width).enumerate();
            parts.map(move |(k, out)| (channel, k * rows, out))
        })
        .collect();
    scratch.buffers.resize_with(tasks.len(), Buffers::default);
    let sums: Vec<[f64; 2]> = tasks
        .into_par_iter()
        .zip(&mut scratch.buffers)
        .with_max_len(1)
        .map(|((channel, top, out), buffers)| {
            let segment = Segment { target, x: &rgb[channel], channel, rows: top..top + out.len() / width, factors };
            dispatch!(level.level(), s => segment::run(s, &segment, buffers, out))
        })
        .collect();
    let (l1, ssim) = sums.iter().fold((0.0, 0.0), |(l1, ssim), part| (l1 + part[0], ssim + part[1]));
    let (l1, ssim) = (l1 / count, ssim / count);
    LossTerms { l1, ssim, total: (1.0 - lambda) * l1 + lambda * (1.0 - ssim) }
}

/// The mean over the channels of `|rgb - target|`, `[height][width]` (the error map: Minute4D Eq. 6).
///
/// # Panics
///
/// If a plane of `rgb` does not hold as many values as the target.
pub fn error_map(level: SimdLevel, target: &Target, rgb: &[Vec<f32>; 3], out: &mut Vec<f32>) {
    let pixels = target.width() * target.height();
    for plane in rgb {
        assert_eq!(plane.len(), pixels, "error_map: planes of the target's size");
    }
    out.resize(pixels, 0.0);
    let size = ERROR_ROWS * target.width().max(1);
    out.par_chunks_mut(size).enumerate().for_each(|(k, rows)| {
        dispatch!(level.level(), s => segment::errors(s, target, rgb, k * size, rows));
    });
}
