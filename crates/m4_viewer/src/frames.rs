//! The source frames shown next to the re-render: a small clip, and a poster of its beginning.

use crate::manifest::FrameIndex;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use m4_core::{ResizeFilter, RgbImage, resize_rgb};
use m4_io::video::{self, CodedFrames, CodedOptions};
use rayon::prelude::*;

/// Longest side of the frames, pixels: as the panels of the preview.
const SIDE_PX: usize = 480;
/// Bytes that all frames of a page together may take.
pub const FRAME_BYTES: usize = 6_000_000;

/// Frames as a clip of H.264.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frames {
    /// Where each begins.
    pub index: FrameIndex,
    /// One after the other, each a part of a byte stream (ITU-T H.264, Annex B).
    pub bytes: Vec<u8>,
    /// The first of them as a JPEG.
    pub poster: Vec<u8>,
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
    #[error("the frames of the page cannot be encoded: {0}")]
    Encode(String),
}

/// Quantisation to begin with; coding begins to be visible at 26.
const QP: u8 = 22;
/// Quantisation is raised by this much at a time, which a third fewer bytes follow, up to
/// [`MOST_QP`]; after that the size.
const QP_STEP: u8 = 4;
const MOST_QP: u8 = 36;
/// No longest side is made smaller than this, however many frames there are.
const LEAST_SIDE_PX: usize = 96;
/// Shortest side that can be encoded.
const LEAST_PX: usize = 16;
/// Seconds from one frame at which decoding can begin to the next: a jump to another time waits for
/// all of them. And the fewest and the most frames: the page keeps three such runs in memory.
const KEYS: (f64, usize, usize) = (0.5, 12, 30);
/// Rates that can be encoded, frames a second; others count as the nearest.
const FPS: (f64, f64) = (0.1, 1000.0);
/// Runs from one such frame to the next that are tried before all are encoded.
const SAMPLES: usize = 4;
/// JPEG quality of the poster, 1 to 100.
const POSTER_QUALITY: u8 = 80;

/// The images, at `fps` frames a second, as a clip that takes at most `most` bytes, as far as that
/// can be held: where it is not enough, quality and then size are lowered. `None` for none.
pub fn encode_frames(
    images: &[&RgbImage],
    fps: f64,
    most: usize,
) -> Result<Option<Frames>, FramesError> {
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
    let fps = match fps.is_nan() {
        true => FPS.0,
        false => fps.clamp(FPS.0, FPS.1),
    };
    let key_every = ((KEYS.0 * fps).ceil() as usize).clamp(KEYS.1, KEYS.2);
    let mut side = SIDE_PX;
    let mut options = CodedOptions {
        fps,
        qp: QP,
        key_every,
    };
    // a few runs tell how large all will be
    let sample = sample(images, key_every);
    loop {
        let coded = encoded(&sample, fit(first.size(), side), &options)?;
        let bytes: usize = coded.frames.iter().map(Vec::len).sum();
        let expected = bytes as f64 / sample.len() as f64 * images.len() as f64;
        if expected <= most as f64 || side <= LEAST_SIDE_PX {
            break;
        }
        if options.qp < MOST_QP {
            options.qp += QP_STEP;
        } else {
            side = (side * 3 / 4).max(LEAST_SIDE_PX);
        }
    }
    let (width, height) = fit(first.size(), side);
    let coded = encoded(images, (width, height), &options)?;
    let (mut bytes, mut offsets) = (Vec::new(), vec![0]);
    for frame in &coded.frames {
        bytes.extend(frame);
        offsets.push(bytes.len());
    }
    let index = FrameIndex {
        width,
        height,
        codec: coded.codec,
        key_every,
        offsets,
    };
    Ok(Some(Frames {
        index,
        bytes,
        poster: jpeg(&resized(first, (width, height))?)?,
    }))
}

/// Evenly spaced runs of `length` images; all images where they are few.
fn sample<'a>(images: &[&'a RgbImage], length: usize) -> Vec<&'a RgbImage> {
    let runs: Vec<&[&RgbImage]> = images.chunks(length).collect();
    let step = runs.len().div_ceil(SAMPLES);
    runs.into_iter().step_by(step).flatten().copied().collect()
}

/// The size with the longest side at most `side`, in even numbers.
fn fit((width, height): (usize, usize), side: usize) -> (usize, usize) {
    let scale = (side as f64 / width.max(height) as f64).min(1.0);
    let scaled = |n: usize| (2 * (n as f64 * scale / 2.0).round() as usize).max(LEAST_PX);
    (scaled(width), scaled(height))
}

fn encoded(
    images: &[&RgbImage],
    size: (usize, usize),
    options: &CodedOptions,
) -> Result<CodedFrames, FramesError> {
    let small: Vec<RgbImage> = images
        .par_iter()
        .map(|image| resized(image, size))
        .collect::<Result<_, _>>()?;
    video::encode_frames(small, options).map_err(FramesError::Encode)
}

fn resized(image: &RgbImage, (width, height): (usize, usize)) -> Result<RgbImage, FramesError> {
    if image.size() == (width, height) {
        return Ok(image.clone());
    }
    resize_rgb(image, width, height, ResizeFilter::Triangle)
        .ok_or_else(|| FramesError::Encode(format!("no size of {width} x {height} pixels")))
}

fn jpeg(image: &RgbImage) -> Result<Vec<u8>, FramesError> {
    let failed = |reason: &dyn std::fmt::Display| FramesError::Encode(reason.to_string());
    let side = |n: usize| u32::try_from(n).map_err(|e| failed(&e));
    let mut out = Vec::new();
    JpegEncoder::new_with_quality(&mut out, POSTER_QUALITY)
        .write_image(
            image.data().as_flattened(),
            side(image.width())?,
            side(image.height())?,
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
    fn frames_are_indexed_and_the_first_is_the_poster() {
        let grey = |v: u8| Plane::filled(200, 101, [v; 3]);
        let images: Vec<RgbImage> = [10, 120, 250].map(grey).into();
        let frames = encode_frames(&images.iter().collect::<Vec<_>>(), 60.0, FRAME_BYTES)
            .unwrap()
            .unwrap();
        let index = &frames.index;
        assert_eq!((index.width, index.height), (200, 102));
        assert_eq!((index.key_every, index.offsets.len()), (30, 4));
        assert_eq!(index.offsets[3], frames.bytes.len());
        assert!(index.codec.starts_with("avc1."), "{}", index.codec);
        // each begins as a unit of the byte stream does
        for start in &index.offsets[..3] {
            assert_eq!(frames.bytes[*start..][..4], [0, 0, 0, 1]);
        }
        let poster = image::load_from_memory(&frames.poster).unwrap().to_rgb8();
        assert_eq!(poster.dimensions(), (200, 102));
        assert!(poster.as_raw().iter().all(|v| v.abs_diff(10) <= 2));
    }

    #[test]
    fn too_many_bytes_cost_quality_and_size() {
        let images: Vec<RgbImage> = (0..20).map(noise).collect();
        let images: Vec<&RgbImage> = images.iter().collect();
        let whole = encode_frames(&images, 24.0, FRAME_BYTES).unwrap().unwrap();
        assert_eq!((whole.index.width, whole.index.height), (480, 270));
        let most = whole.bytes.len() / 20;
        let tight = encode_frames(&images, 24.0, most).unwrap().unwrap();
        assert!(
            tight.bytes.len() < most * 11 / 10,
            "{} bytes, {most} wanted",
            tight.bytes.len()
        );
        assert!(tight.index.width < 480);
    }

    #[test]
    fn no_frames_and_empty_frames() {
        assert_eq!(encode_frames(&[], 24.0, FRAME_BYTES), Ok(None));
        let empty = Plane::filled(0, 4, [0; 3]);
        assert!(encode_frames(&[&empty], 24.0, FRAME_BYTES).is_err());
    }

    #[test]
    fn any_rate_can_be_encoded() {
        let grey = Plane::filled(40, 30, [90; 3]);
        for (fps, key_every) in [(f64::NAN, 12), (0.0, 12), (240.0, 30), (f64::INFINITY, 30)] {
            let frames = encode_frames(&[&grey; 40], fps, FRAME_BYTES).unwrap();
            assert_eq!(frames.unwrap().index.key_every, key_every, "{fps}");
        }
    }

    #[test]
    fn a_tiny_or_narrow_image_is_made_large_enough() {
        let narrow = Plane::filled(3000, 20, [90; 3]);
        let frames = encode_frames(&[&narrow], 24.0, FRAME_BYTES)
            .unwrap()
            .unwrap();
        assert_eq!((frames.index.width, frames.index.height), (480, 16));
    }
}
