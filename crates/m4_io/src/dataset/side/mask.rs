//! Masks of dynamic regions, one per file, or a stack in an npz archive.

use super::depth::Stack;
use crate::dataset::files::{check_pixels, image_size};
use crate::files::first_bytes;
use crate::{Fault, image};
use m4_core::{CompactIds, CompactMask, Plane, Progress};
use png::{BitDepth, ColorType, Decoder, Limits, Transformations};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Extensions of masks that are read.
pub(crate) const EXTENSIONS: &[&str] = &["png", "jpg", "jpeg"];
/// Names under which archives hold masks.
const KEYS: &[&str] = &["masks", "mask", "dyn_masks", "arr_0"];

/// A mask and, if its file distinguishes objects, the object of each pixel.
#[derive(Debug, Clone)]
pub struct ReadMask {
    /// Set where something moves.
    pub mask: CompactMask,
    /// Of a PNG with a palette: its numbers, 0 for nothing.
    pub instances: Option<CompactIds>,
}

/// Reads a mask: PNG, set where the number of the palette, the grey value or the colour is not 0; JPEG, set where the brightness
/// is at least 128. With `invert` the other way round; then instances are not distinguished.
/// Errors: it cannot be read or is damaged.
pub fn read_mask(path: &Path, invert: bool) -> Result<ReadMask, Fault> {
    if !first_bytes::<4>(path).starts_with(b"\x89PNG") {
        image_size(path)?;
        let grey = image::read_grey(path)?;
        let (w, h) = grey.size();
        return Ok(ReadMask {
            mask: CompactMask::from_fn(w, h, |x, y| (grey[(x, y)] >= 128) != invert),
            instances: None,
        });
    }
    let numbers = read_numbers(path)?;
    let (w, h) = numbers.plane.size();
    Ok(ReadMask {
        mask: CompactMask::from_fn(w, h, |x, y| (numbers.plane[(x, y)] != 0) != invert),
        instances: (numbers.palette && !invert).then(|| CompactIds::from(&numbers.plane)),
    })
}

/// Whether a file is a PNG with a palette, by its head: the type of colour is byte 25 (PNG specification, 11.2.2).
pub(crate) fn has_objects(path: &Path) -> bool {
    let start = first_bytes::<26>(path);
    start.starts_with(b"\x89PNG") && start.get(12..16) == Some(b"IHDR") && start.get(25) == Some(&3)
}

/// A stack of masks: whole numbers that are not 0, floats above one half.
pub(crate) fn read_stack(
    path: &Path,
    frames: usize,
    invert: bool,
    limit_bytes: u64,
    progress: &dyn Progress,
) -> Result<Vec<CompactMask>, Fault> {
    Stack::open(path, KEYS, frames, limit_bytes, progress, |stack, values| {
        let from = if stack.whole { 0.0 } else { 0.5 };
        let w = stack.width;
        Ok(CompactMask::from_fn(w, stack.height, |x, y| (values[y * w + x] > from) != invert))
    })
}

/// Largest side and what an image may take, bytes.
const MAX_SIDE: u32 = 32_768;
const MAX_BYTES: usize = 512 << 20;
/// What deflate makes of a byte at most, and what a file of any length may unpack to.
const MAX_RATIO: u64 = 1032;
const FREE_BYTES: u64 = 4 << 20;

/// A PNG image of numbers.
pub(crate) struct Numbers {
    /// A number per pixel: index, grey value, or 1 where a colour is not black.
    pub plane: Plane<u16>,
    /// Whether the numbers are indices of a palette: each stands for a thing.
    pub palette: bool,
}

/// Reads one.
pub(crate) fn read_numbers(path: &Path) -> Result<Numbers, Fault> {
    let damaged = |e: png::DecodingError| Fault::bad(format!("the PNG file cannot be read ({e})"), "export it again");
    let file = File::open(path)?;
    let file_bytes = file.metadata()?.len();
    let mut decoder = Decoder::new_with_limits(BufReader::new(file), Limits { bytes: MAX_BYTES });
    decoder.set_transformations(Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let (width, height) = reader.info().size();
    if width > MAX_SIDE || height > MAX_SIDE {
        return Err(Fault::unsupported(format!("an image of {width} x {height} pixels"), "resize it"));
    }
    let (w, h) = (width as usize, height as usize);
    check_pixels(w, h, file_bytes)?;
    let bytes = reader.output_buffer_size().filter(|&n| n <= MAX_BYTES);
    let Some(bytes) = bytes else {
        return Err(Fault::unsupported(format!("an image of {w} x {h} pixels"), "resize it"));
    };
    if bytes as u64 > file_bytes.saturating_mul(MAX_RATIO).max(FREE_BYTES) {
        let what = format!("{w} x {h} pixels are claimed by {file_bytes} bytes");
        return Err(Fault::bad(what, "the file is damaged; export it again"));
    }
    let mut data = vec![0; bytes];
    let frame = reader.next_frame(&mut data).map_err(damaged)?;
    let line = frame.line_size;
    let whole = line.checked_mul(h).is_some_and(|n| n <= data.len());
    if (frame.width, frame.height) != (width, height) || !whole {
        let what = format!("a frame of {} x {} pixels in an image of {w} x {h}", frame.width, frame.height);
        return Err(Fault::bad(what, "export it again"));
    }
    let (bits, channels) = (frame.bit_depth as usize, frame.color_type.samples());
    if line * 8 < w * bits * channels {
        return Err(Fault::bad("its rows are too short", "export it again"));
    }
    // sample c of pixel x of row y
    let sample = |x: usize, y: usize, c: usize| -> u16 {
        let row = &data[y * line..];
        let i = x * channels + c;
        match frame.bit_depth {
            BitDepth::Sixteen => u16::from_be_bytes([row[2 * i], row[2 * i + 1]]),
            BitDepth::Eight => row[i].into(),
            _ => u16::from(row[i * bits / 8] >> (8 - bits - i * bits % 8)) & ((1 << bits) - 1),
        }
    };
    let plane = Plane::from_fn(w, h, |x, y| match frame.color_type {
        ColorType::Indexed | ColorType::Grayscale | ColorType::GrayscaleAlpha => sample(x, y, 0),
        ColorType::Rgb | ColorType::Rgba => u16::from((0..3).any(|c| sample(x, y, c) != 0)),
    });
    Ok(Numbers { plane, palette: frame.color_type == ColorType::Indexed })
}
