//! Masks of dynamic regions, one per file, or a stack in an npz archive.

use super::palette::read_numbers;
use super::stack::Stack;
use crate::dataset::SourceErrorCause;
use crate::dataset::files::first_bytes;
use crate::dataset::files::images::size_of;
use crate::image;
use m4_core::{CompactIds, CompactMask, Progress};
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
///
/// # Errors
///
/// [`SourceErrorCause`]: it cannot be read or is damaged.
pub fn read_mask(path: &Path, invert: bool) -> Result<ReadMask, SourceErrorCause> {
    if !first_bytes::<4>(path).starts_with(b"\x89PNG") {
        size_of(path)?;
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
) -> Result<Vec<CompactMask>, SourceErrorCause> {
    Stack::open(path, KEYS, frames, limit_bytes, progress, |stack, values| {
        let from = if stack.whole_numbers { 0.0 } else { 0.5 };
        let w = stack.width;
        Ok(CompactMask::from_fn(w, stack.height, |x, y| {
            (values[y * w + x] > from) != invert
        }))
    })
}
