//! The SIMD version: each channel is divided into fixed segments of rows, which are tasks.

use crate::{
    SimdLevel,
    loss::{
        buffers::Buffers,
        segment::{self, Segment},
    },
    simd::{LANES, all, dispatch, each},
};
use fearless_simd::{Simd, f32x16, prelude::*};
use m4_core::ShapeError;
use rayon::prelude::*;

/// Rows a task, at most: the blurs of a task look twice five rows beyond its own, so short ones
/// cost.
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
/// Panics if a plane of `rgb` does not hold as many values as the target.
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
            let segment = Segment {
                target,
                x: &rgb[channel],
                channel,
                rows: top..top + out.len() / width,
                factors,
            };
            dispatch!(level.level(), s => segment::run(s, &segment, buffers, out))
        })
        .collect();
    let (l1, ssim) = sums.iter().fold((0.0, 0.0), |(l1, ssim), part| {
        (l1 + part[0], ssim + part[1])
    });
    let (l1, ssim) = (l1 / count, ssim / count);
    LossTerms {
        l1,
        ssim,
        total: (1.0 - lambda) * l1 + lambda * (1.0 - ssim),
    }
}

/// The mean over the channels of `|rgb - target|`, `[height][width]` (the error map:
/// Minute4D Eq. 6). Panics if a plane of `rgb` does not hold as many values as the target.
pub fn error_map(level: SimdLevel, target: &Target, rgb: &[Vec<f32>; 3], out: &mut Vec<f32>) {
    let pixels = target.width() * target.height();
    for plane in rgb {
        assert_eq!(
            plane.len(),
            pixels,
            "error_map: planes of the target's size"
        );
    }
    out.resize(pixels, 0.0);
    let size = ERROR_ROWS * target.width().max(1);
    out.par_chunks_mut(size).enumerate().for_each(|(k, rows)| {
        dispatch!(level.level(), s => segment::errors(s, target, rgb, k * size, rows));
    });
}

/// A photograph to compare with: one plane of bytes per channel, `[height][width]` each.
///
/// A video is kept whole, so what a frame takes counts: three bytes per pixel. What SSIM needs of
/// the target alone is blurred again at each comparison: one of seven blurs, and cheaper than
/// fetching it from memory for every frame of a video.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Target {
    width: usize,
    height: usize,
    planes: [Vec<u8>; 3],
}

impl Target {
    /// Takes the planes of a photograph, 0..=255. Fails with [`ShapeError`] if a plane does not
    /// hold `width * height` values.
    pub fn from_bytes(
        width: usize,
        height: usize,
        planes: [Vec<u8>; 3],
    ) -> Result<Self, ShapeError> {
        for plane in &planes {
            ShapeError::check("target plane", width * height, plane.len())?;
        }
        Ok(Self {
            width,
            height,
            planes,
        })
    }

    /// Becomes a photograph, in the memory that is there: `fill` writes the planes, 0..=255, over
    /// whatever they hold.
    pub fn replace(&mut self, width: usize, height: usize, fill: impl FnOnce([&mut [u8]; 3])) {
        (self.width, self.height) = (width, height);
        self.planes
            .iter_mut()
            .for_each(|plane| plane.resize(width * height, 0));
        fill(self.planes.each_mut().map(Vec::as_mut_slice));
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The planes, 0..=255.
    pub fn planes(&self) -> &[Vec<u8>; 3] {
        &self.planes
    }

    /// The image, one plane per channel, 0..1.
    pub fn rgb(&self) -> [Vec<f32>; 3] {
        self.planes
            .each_ref()
            .map(|p| p.iter().map(|&v| f32::from(v) * BYTE).collect())
    }

    /// Values `from..from + out.len()` of a plane, 0..1.
    #[inline(always)]
    pub(super) fn read<S: Simd>(&self, s: S, channel: usize, from: usize, out: &mut [f32]) {
        widen(s, &self.planes[channel][from..from + out.len()], out);
    }
}

/// What a step of a byte is worth.
const BYTE: f32 = 1.0 / 255.0;

/// Bytes as colours.
#[inline(always)]
fn widen<S: Simd>(s: S, values: &[u8], out: &mut [f32]) {
    let scale = all(s, BYTE);
    let (whole, rest) = values.as_chunks::<LANES>();
    for (part, out) in whole.iter().zip(out.chunks_exact_mut(LANES)) {
        let wide: [f32; LANES] = each!(LANES, k => part[k].into());
        (f32x16::from_slice(s, &wide) * scale).store_slice(out);
    }
    let done = whole.len() * LANES;
    for (&v, out) in rest.iter().zip(&mut out[done..]) {
        *out = f32::from(v) * BYTE;
    }
}
