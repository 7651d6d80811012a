//! One depth map a file, or a stack in an npz archive.

mod exr;
mod pfm;

pub use exr::decode_exr;
pub use pfm::decode_pfm;

use super::stack::Stack;
use crate::core::SourceFault;
use crate::files::{NpyFile, first_bytes, opened_size};
use m4_io::image;
use m4_scene::{CompactDepth, DepthMap, Plane, Progress};
use std::path::Path;

/// Extensions of maps that are read.
pub(crate) const EXTENSIONS: &[&str] = &["png", "exr", "pfm", "npy"];
/// Largest file of one map.
const MAX_FILE_BYTES: u64 = 1 << 30;
/// Largest map in memory: 64 million pixels of 8 bytes.
const MAX_MAP_BYTES: u64 = 512 << 20;
/// Names under which archives hold depth.
const KEYS: &[&str] = &["depths", "depth", "arr_0"];

/// One map of z-depth by its first bytes: EXR, PFM, npy, or PNG of 16 bits. `unit` is that of a step of whole numbers; floats are
/// taken as they are. What is not a number above 0 is unknown.
///
/// # Errors
///
/// [`SourceFault`]: it cannot be read, is damaged, or holds no depth.
pub fn read_depth(path: &Path, unit: f64) -> Result<CompactDepth, SourceFault> {
    let start = first_bytes::<6>(path);
    if start.starts_with(b"\x89PNG") {
        opened_size(path)?;
        return Ok(image::read_depth(path, unit)?);
    }
    let all = || crate::files::bytes(path, MAX_FILE_BYTES).map_err(|e| e.fault);
    if start.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        return Ok(decode_exr(&all()?)?.into());
    }
    if start.starts_with(b"Pf") || start.starts_with(b"PF") {
        return Ok(decode_pfm(&all()?)?.into());
    }
    if start.starts_with(b"\x93NUMPY") {
        return npy(path, unit);
    }
    if start.is_empty() {
        // says what the system says, or that there is nothing in it
        std::fs::File::open(path)?;
        return Err(SourceFault::bad("the file is empty", "export it again"));
    }
    Err(SourceFault::unsupported(
        "it is no depth map that is read here",
        "give PNG of 16 bits, EXR, PFM or npy",
    ))
}

/// `[h][w]`, also with a dimension of 1 before or after.
fn npy(path: &Path, unit: f64) -> Result<CompactDepth, SourceFault> {
    let array = NpyFile::read(path, MAX_MAP_BYTES)?;
    let (height, width) = match array.shape[..] {
        [h, w] | [h, w, 1] | [1, h, w] => (h, w),
        _ => {
            let what = format!("an array of shape {:?}; [height, width] was expected", array.shape);
            return Err(SourceFault::bad(what, "save one map a file"));
        }
    };
    let unit = if array.whole_numbers { unit } else { 1.0 };
    map(width, height, array.values.iter().map(|v| (v * unit) as f32))
}

/// A stack of maps.
pub(crate) fn read_stack(
    path: &Path,
    frames: usize,
    unit: f64,
    limit_bytes: u64,
    progress: &dyn Progress,
) -> Result<Vec<CompactDepth>, SourceFault> {
    Stack::open(path, KEYS, frames, limit_bytes, progress, |stack, values| {
        let unit = if stack.whole_numbers { unit } else { 1.0 };
        map(stack.width, stack.height, values.iter().map(|v| (v * unit) as f32))
    })
}

fn map(width: usize, height: usize, values: impl Iterator<Item = f32>) -> Result<CompactDepth, SourceFault> {
    let values = values.map(known).collect();
    let map: DepthMap =
        Plane::from_vec(width, height, values).map_err(|e| SourceFault::bad(e.to_string(), "export it again"))?;
    if map.data().is_empty() {
        return Err(SourceFault::bad(
            format!("a map of {width} x {height} pixels"),
            "export it again",
        ));
    }
    Ok(map.into())
}

/// Depth, 0 where it is not known.
pub(crate) fn known(z: f32) -> f32 {
    if z.is_finite() && z > 0.0 { z } else { 0.0 }
}
