//! The source frames shown next to the re-render: small JPEGs, one after the other.

use crate::manifest::FrameIndex;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use m4_core::{ResizeFilter, RgbImage, resize_rgb};
use rayon::prelude::*;
use std::borrow::Cow;

/// Longest side of the frames, pixels: as the panels of the preview.
const SIDE_PX: usize = 480;
/// Bytes that all frames of a page together may take.
pub const FRAME_BYTES: usize = 6_000_000;

/// Frames as JPEGs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frames {
    /// Where each begins.
    pub index: FrameIndex,
    /// One after the other.
    pub bytes: Vec<u8>,
}

/// Why frames cannot be put into the page.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FramesError {
    /// An image without pixels.
    #[error("frame {index} is {width} x {height} pixels; it must have some")]
    Empty {
        /// The frame.
        index: usize,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The encoder.
    #[error("frame {index} cannot be written as a JPEG: {reason}")]
    Encode {
        /// The frame.
        index: usize,
        /// Its message.
        reason: String,
    },
}

/// JPEG quality to begin with, 1 to 100: blocks are not seen at this size.
const QUALITY: u8 = 80;
/// Quality is lowered by this much at a time, down to [`LEAST_QUALITY`]; after that the size.
const QUALITY_STEP: u8 = 15;
const LEAST_QUALITY: u8 = 50;
/// No frame is made smaller than this, however many there are.
const LEAST_SIDE_PX: usize = 96;
/// Frames that are tried before all are written.
const SAMPLES: usize = 8;

/// The images as JPEGs of one size that together take at most `most` bytes, as far as that can be
/// held: where it is not enough, quality and then size are lowered. `None` for none.
pub fn encode_frames(images: &[&RgbImage], most: usize) -> Result<Option<Frames>, FramesError> {
    for (index, image) in images.iter().enumerate() {
        let (width, height) = image.size();
        if width == 0 || height == 0 {
            return Err(FramesError::Empty {
                index,
                width,
                height,
            });
        }
    }
    let Some(first) = images.first() else {
        return Ok(None);
    };
    let mut side = SIDE_PX;
    let mut quality = QUALITY;
    // a few frames tell how large all will be
    let step = images.len().div_ceil(SAMPLES);
    loop {
        let size = fit(first.size(), side);
        let sampled = encoded(images, step, size, quality)?;
        let bytes: usize = sampled.iter().map(Vec::len).sum();
        let expected = bytes as f64 / sampled.len() as f64 * images.len() as f64;
        if expected <= most as f64 || side <= LEAST_SIDE_PX {
            break;
        }
        if quality >= LEAST_QUALITY + QUALITY_STEP {
            quality -= QUALITY_STEP;
        } else {
            side = (side * 3 / 4).max(LEAST_SIDE_PX);
        }
    }
    let size = fit(first.size(), side);
    let (mut bytes, mut offsets) = (Vec::new(), vec![0]);
    for jpeg in encoded(images, 1, size, quality)? {
        bytes.extend(jpeg);
        offsets.push(bytes.len());
    }
    let index = FrameIndex {
        width: size.0,
        height: size.1,
        offsets,
    };
    Ok(Some(Frames { index, bytes }))
}

/// The size with the longest side at most `side`.
fn fit((width, height): (usize, usize), side: usize) -> (usize, usize) {
    let scale = (side as f64 / width.max(height) as f64).min(1.0);
    let scaled = |n: usize| ((n as f64 * scale).round() as usize).max(1);
    (scaled(width), scaled(height))
}

/// Every `step`th image as a JPEG.
fn encoded(
    images: &[&RgbImage],
    step: usize,
    size: (usize, usize),
    quality: u8,
) -> Result<Vec<Vec<u8>>, FramesError> {
    (0..images.len().div_ceil(step))
        .into_par_iter()
        .map(|i| jpeg(images[i * step], i * step, size, quality))
        .collect()
}

fn jpeg(
    image: &RgbImage,
    index: usize,
    (width, height): (usize, usize),
    quality: u8,
) -> Result<Vec<u8>, FramesError> {
    let failed = |reason: &dyn std::fmt::Display| FramesError::Encode {
        index,
        reason: reason.to_string(),
    };
    let small = if image.size() == (width, height) {
        Cow::Borrowed(image)
    } else {
        Cow::Owned(
            resize_rgb(image, width, height, ResizeFilter::Triangle)
                .ok_or_else(|| failed(&"it cannot be made smaller"))?,
        )
    };
    let side = |n: usize| u32::try_from(n).map_err(|e| failed(&e));
    let mut out = Vec::new();
    JpegEncoder::new_with_quality(&mut out, quality)
        .write_image(
            small.data().as_flattened(),
            side(width)?,
            side(height)?,
            ExtendedColorType::Rgb8,
        )
        .map_err(|e| failed(&e))?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::{FRAME_BYTES, encode_frames};
    use m4_core::{CounterRng, Plane, RgbImage};

    fn noise(index: u64) -> RgbImage {
        let mut rng = CounterRng::new(1, 2, index);
        Plane::from_fn(640, 360, |_, _| {
            std::array::from_fn(|_| (255.0 * rng.uniform()) as u8)
        })
    }

    #[test]
    fn frames_come_back_at_their_offsets() {
        let grey = |v: u8| Plane::filled(200, 100, [v; 3]);
        let images: Vec<RgbImage> = [10, 120, 250].map(grey).into();
        let frames = encode_frames(&images.iter().collect::<Vec<_>>(), FRAME_BYTES)
            .unwrap()
            .unwrap();
        assert_eq!((frames.index.width, frames.index.height), (200, 100));
        assert_eq!(frames.index.offsets.len(), 4);
        assert_eq!(frames.index.offsets[3], frames.bytes.len());
        for (i, value) in [10u8, 120, 250].into_iter().enumerate() {
            let jpeg = &frames.bytes[frames.index.offsets[i]..frames.index.offsets[i + 1]];
            let image = image::load_from_memory(jpeg).unwrap().to_rgb8();
            assert_eq!(image.dimensions(), (200, 100));
            assert!(
                image.as_raw().iter().all(|v| v.abs_diff(value) <= 2),
                "frame {i}"
            );
        }
    }

    #[test]
    fn too_many_bytes_cost_quality_and_size() {
        let images: Vec<RgbImage> = (0..20).map(noise).collect();
        let images: Vec<&RgbImage> = images.iter().collect();
        let whole = encode_frames(&images, FRAME_BYTES).unwrap().unwrap();
        assert_eq!((whole.index.width, whole.index.height), (480, 270));
        let most = whole.bytes.len() / 6;
        let tight = encode_frames(&images, most).unwrap().unwrap();
        assert!(
            tight.bytes.len() < most * 11 / 10,
            "{} bytes",
            tight.bytes.len()
        );
        assert!(tight.index.width < 480);
    }

    #[test]
    fn no_frames_and_empty_frames() {
        assert_eq!(encode_frames(&[], FRAME_BYTES), Ok(None));
        let empty = Plane::filled(0, 4, [0; 3]);
        assert!(encode_frames(&[&empty], FRAME_BYTES).is_err());
    }
}
