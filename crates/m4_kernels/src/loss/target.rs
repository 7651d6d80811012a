//! A target image, stored compactly.

use crate::simd::{LANES, all, each};
use fearless_simd::{Simd, f32x16, prelude::*};
use m4_core::ShapeError;

/// An image to compare with: one plane per channel, `[height][width]` each, 0..1.
///
/// A video is kept whole, so what a frame takes counts: a photograph is three bytes per pixel. What SSIM
/// needs of the target alone is blurred again at each comparison: one of seven blurs, and cheaper than
/// fetching it from memory for every frame of a video.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Target {
    width: usize,
    height: usize,
    samples: Samples,
}

/// What the planes hold: values 0..1, or bytes.
#[derive(Debug, Clone, PartialEq)]
enum Samples {
    Floats([Vec<f32>; 3]),
    Bytes([Vec<u8>; 3]),
}

/// The planes of a [`Target`] as they are kept, one per channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TargetPlanes<'a> {
    /// Colours 0..1.
    Floats([&'a [f32]; 3]),
    /// Colours 0..=255.
    Bytes([&'a [u8]; 3]),
}

impl Default for Samples {
    fn default() -> Self {
        Self::Bytes(Default::default())
    }
}

impl Target {
    /// Takes the planes of an image, 0..1.
    ///
    /// # Errors
    ///
    /// [`ShapeError`] if a plane does not hold `width * height` values.
    pub fn new(width: usize, height: usize, rgb: [Vec<f32>; 3]) -> Result<Self, ShapeError> {
        Self::check(width, height, rgb.each_ref().map(Vec::len), Samples::Floats(rgb))
    }

    /// Takes the planes of a photograph, 0..=255.
    ///
    /// # Errors
    ///
    /// As [`new`](Self::new).
    pub fn from_bytes(width: usize, height: usize, rgb: [Vec<u8>; 3]) -> Result<Self, ShapeError> {
        Self::check(width, height, rgb.each_ref().map(Vec::len), Samples::Bytes(rgb))
    }

    fn check(width: usize, height: usize, lengths: [usize; 3], samples: Samples) -> Result<Self, ShapeError> {
        for length in lengths {
            ShapeError::check("target plane", width * height, length)?;
        }
        Ok(Self { width, height, samples })
    }

    /// Becomes a photograph, in the memory that is there: `fill` writes the planes, 0..=255, over whatever
    /// they hold.
    pub fn replace(&mut self, width: usize, height: usize, fill: impl FnOnce([&mut [u8]; 3])) {
        (self.width, self.height) = (width, height);
        let mut planes = match std::mem::take(&mut self.samples) {
            Samples::Bytes(planes) => planes,
            _ => Default::default(),
        };
        planes.iter_mut().for_each(|plane| plane.resize(width * height, 0));
        fill(planes.each_mut().map(Vec::as_mut_slice));
        self.samples = Samples::Bytes(planes);
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

    /// Bytes that the planes take.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let each = match self.samples {
            Samples::Floats(_) => 4,
            Samples::Bytes(_) => 1,
        };
        3 * self.width * self.height * each
    }

    /// The image as it is stored, for copies elsewhere.
    #[must_use]
    pub fn planes(&self) -> TargetPlanes<'_> {
        match &self.samples {
            Samples::Floats(rgb) => TargetPlanes::Floats(rgb.each_ref().map(Vec::as_slice)),
            Samples::Bytes(rgb) => TargetPlanes::Bytes(rgb.each_ref().map(Vec::as_slice)),
        }
    }

    /// The image, one plane per channel, 0..1.
    #[must_use]
    pub fn rgb(&self) -> [Vec<f32>; 3] {
        match &self.samples {
            Samples::Floats(rgb) => rgb.clone(),
            Samples::Bytes(rgb) => rgb.each_ref().map(|p| p.iter().map(|&v| f32::from(v) * BYTE).collect()),
        }
    }

    /// Values `from..from + out.len()` of a plane.
    #[inline(always)]
    pub(super) fn read<S: Simd>(&self, s: S, channel: usize, from: usize, out: &mut [f32]) {
        let range = from..from + out.len();
        match &self.samples {
            Samples::Floats(rgb) => out.copy_from_slice(&rgb[channel][range]),
            Samples::Bytes(rgb) => widen(s, &rgb[channel][range], out),
        }
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
