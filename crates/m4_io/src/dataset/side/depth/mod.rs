//! Depth maps: one per file, or a stack in an npz archive.
//!
//! ```text
//! exr, pfm   files of these formats; PNG is m4_io's, npy of crate::dataset::files
//! sensor     depth where its confidence is not 0
//! ```

mod exr;
mod pfm;
mod sensor;

pub use exr::decode_exr;
pub use pfm::decode_pfm;
pub(crate) use sensor::kept_where;

use super::stack::Stack;
use crate::dataset::files::npy::{NpyFile, array_of, open_npz, present};
use crate::dataset::files::{bytes, first_bytes, images};
use crate::dataset::{FrameSource, ImportOptions, SourceErrorCause};
use crate::image;
use m4_core::{CompactDepth, DepthMap, Plane, Progress};
use std::path::{Path, PathBuf};

/// Extensions of maps that are read of a folder.
pub(crate) const EXTENSIONS: &[&str] = &["png", "exr", "pfm", "npy"];
/// Default scene units per step of 16-bit depth maps: millimetres if the unit is a metre.
pub(crate) const DEFAULT_UNIT: f64 = 1e-3;
/// Largest unit of depth.
const MAX_UNIT: f64 = 1e6;
/// Largest file of one map.
const MAX_FILE_BYTES: u64 = 1 << 30;
/// Largest map in memory: 134 million pixels of 8 bytes.
const MAX_MAP_BYTES: u64 = 1 << 30;
/// Names under which archives hold depth.
const KEYS: &[&str] = &["depths", "depth", "depth_map", "arr_0"];

/// Scene units per step of 16-bit depth: what the options say, else `default`.
pub(crate) fn unit(options: &ImportOptions, default: f64) -> Result<f64, SourceErrorCause> {
    let unit = options.depth_unit.unwrap_or(default);
    if unit > 0.0 && unit <= MAX_UNIT {
        return Ok(unit);
    }
    let what = format!("the option depth_unit is {unit}; scene units per step, above 0, were expected");
    Err(SourceErrorCause::bad(what, "give another"))
}

/// One map of z-depth by its first bytes: EXR, PFM, npy, npz (`depth`, `depths`, `depth_map` or `arr_0`), or PNG of 16 bits. `unit` is
/// that of a step of whole numbers; floats are taken as they are. NaN, infinite and other values not above 0 are unknown.
///
/// # Errors
///
/// [`SourceErrorCause`]: it cannot be read, is damaged, or holds no depth.
pub fn read_depth(path: &Path, unit: f64) -> Result<CompactDepth, SourceErrorCause> {
    read_in(path, unit, 1.0)
}

/// The map of a file when its turn comes, with `unit` for whole numbers and `float_unit` for floats; faults name the file.
pub(crate) fn source(file: PathBuf, unit: f64, float_unit: f64) -> FrameSource<CompactDepth> {
    FrameSource::new(move || read_in(&file, unit, float_unit).map_err(|e| e.of_file(&file)))
}

fn read_in(path: &Path, unit: f64, float_unit: f64) -> Result<CompactDepth, SourceErrorCause> {
    let start = first_bytes::<6>(path);
    if start.starts_with(b"\x89PNG") {
        images::size_of(path)?;
        return Ok(image::read_depth(path, unit)?);
    }
    let of_array = |array: NpyFile| {
        let (h, w) = array.map_size()?;
        map(w, h, array.values, if array.whole_numbers { unit } else { float_unit })
    };
    if start.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        return Ok(in_unit(decode_exr(&bytes(path, MAX_FILE_BYTES)?)?, float_unit));
    }
    if start.starts_with(b"Pf") || start.starts_with(b"PF") {
        return Ok(in_unit(decode_pfm(&bytes(path, MAX_FILE_BYTES)?)?, float_unit));
    }
    if start.starts_with(b"\x93NUMPY") {
        return of_array(NpyFile::read(path, MAX_MAP_BYTES)?);
    }
    if start.starts_with(b"PK") {
        let mut npz = open_npz(path)?;
        let key = present(&npz, KEYS).ok_or_else(|| {
            let what = format!("an array of depth ({})", KEYS.join(", "));
            SourceErrorCause::missing(what, format!("it has {}", npz.names()))
        })?;
        return of_array(NpyFile::of_array(array_of(&mut npz, key, MAX_MAP_BYTES / 8)?)?);
    }
    if start.is_empty() {
        // says what the system says, or that there is nothing in it
        std::fs::File::open(path)?;
        return Err(SourceErrorCause::bad("the file is empty", "export it again"));
    }
    Err(SourceErrorCause::unsupported(
        "its format is not supported for depth maps",
        "give PNG of 16 bits, EXR, PFM, npy or npz",
    ))
}

/// A stack of maps.
pub(crate) fn read_stack(
    path: &Path,
    frames: usize,
    unit: f64,
    limit_bytes: u64,
    progress: &dyn Progress,
) -> Result<Vec<CompactDepth>, SourceErrorCause> {
    Stack::open(path, KEYS, frames, limit_bytes, progress, |stack, values| {
        let unit = if stack.whole_numbers { unit } else { 1.0 };
        map(stack.width, stack.height, values, unit)
    })
}

/// The map of numbers times `unit`, rows from the top; NaN, infinite and other values not above 0 are unknown.
fn map(width: usize, height: usize, values: Vec<f64>, unit: f64) -> Result<CompactDepth, SourceErrorCause> {
    let values = values.into_iter().map(|v| known((v * unit) as f32)).collect();
    let map: DepthMap =
        Plane::from_vec(width, height, values).map_err(|e| SourceErrorCause::bad(e.to_string(), "export it again"))?;
    if map.data().is_empty() {
        let what = format!("a map of {width} x {height} pixels");
        return Err(SourceErrorCause::bad(what, "export it again"));
    }
    Ok(map.into())
}

/// A map of floats times `unit`.
fn in_unit(map: DepthMap, unit: f64) -> CompactDepth {
    if unit == 1.0 {
        return map.into();
    }
    map.map(|&z| known((f64::from(z) * unit) as f32)).into()
}

/// Depth, 0 where it is not known.
pub(crate) fn known(z: f32) -> f32 {
    if z.is_finite() && z > 0.0 { z } else { 0.0 }
}
