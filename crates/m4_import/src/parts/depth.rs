//! One depth map from a file of any kind that tools write.

use super::{exr, file};
use crate::core::SourceFault;
use m4_io::image;
use m4_io::npy::{Array, ArrayFault, Npz};
use m4_scene::{CompactDepth, DepthMap, Plane};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// What a depth map may take, bytes: 16,384 x 8,192 pixels of 64 bits.
const MAX_MAP_BYTES: u64 = 1 << 30;
/// Keys of depth in archives.
const KEYS: [&str; 4] = ["depth", "depths", "depth_map", "arr_0"];

/// Reads a z-depth map: a greyscale PNG of 16 bits, times `unit`; `.npy` `[h][w]` or `[h][w][1]`, `.npz` with such an array, and EXR
/// with a channel Z, Y or R, times `float_unit`. What is no number or not above 0 is unknown.
pub(crate) fn read(path: &Path, unit: f64, float_unit: f64) -> Result<CompactDepth, SourceFault> {
    of_any(path, unit, float_unit).map_err(|fault| file::named(path, fault))
}

fn of_any(path: &Path, unit: f64, float_unit: f64) -> Result<CompactDepth, SourceFault> {
    let mut start = Vec::new();
    File::open(path)?.take(8).read_to_end(&mut start)?;
    if start.starts_with(b"\x93NUMPY") {
        let open = File::open(path)?;
        let bytes = open.metadata()?.len();
        let array = Array::open(BufReader::new(open), bytes, MAX_MAP_BYTES).map_err(of_array)?;
        return map(array, float_unit);
    }
    if start.starts_with(b"PK") {
        let mut npz = Npz::open(path)?.map_err(no_archive)?;
        let key = KEYS.into_iter().find(|key| npz.has(key)).ok_or_else(|| {
            SourceFault::missing(
                format!("an array of depth ({})", KEYS.join(", ")),
                format!("it has {}", npz.names()),
            )
        })?;
        let array = npz.array(key, MAX_MAP_BYTES).map_err(of_array)?;
        let array = array.ok_or_else(|| SourceFault::missing(key, "save it again"))?;
        return map(array, float_unit);
    }
    if start.starts_with(exr::MAGIC) {
        let values = exr::read_depth(&file::bytes(path, MAX_MAP_BYTES)?)?;
        return Ok(known(values.map(|&z| f64::from(z) * float_unit)));
    }
    Ok(image::read_depth(path, unit)?)
}

/// The only array of a file as a map.
fn map(mut array: Array<'_>, unit: f64) -> Result<CompactDepth, SourceFault> {
    let (h, w) = match *array.shape.as_slice() {
        [h, w] | [h, w, 1] | [1, h, w] | [1, h, w, 1] if h * w > 0 => (h, w),
        ref other => {
            let what = format!("its depth has shape {other:?}; (height, width) was expected");
            return Err(SourceFault::bad(what, "save one map a file"));
        }
    };
    let values = array.next_f64(w * h).map_err(of_array)?;
    array.end().map_err(of_array)?;
    plane(w, h, values, unit)
}

/// A map of z-depth; what is no number or not above 0 is unknown.
pub(crate) fn plane(w: usize, h: usize, values: Vec<f64>, unit: f64) -> Result<CompactDepth, SourceFault> {
    let plane = Plane::from_vec(w, h, values);
    let plane = plane.map_err(|e| SourceFault::bad(e.to_string(), "save the map again"))?;
    Ok(known(plane.map(|&z| z * unit)))
}

fn known(values: Plane<f64>) -> CompactDepth {
    let map: DepthMap = values.map(|&z| if z.is_finite() && z > 0.0 { z as f32 } else { 0.0 });
    CompactDepth::from(map)
}

/// What is wrong with an array, as a fault of the file.
pub(crate) fn of_array(fault: ArrayFault) -> SourceFault {
    match fault {
        ArrayFault::Bad(reason) => SourceFault::bad(format!("the array {reason}"), "save it again"),
        ArrayFault::TooLarge {
            needed_bytes,
            limit_bytes,
        } => SourceFault::TooLarge {
            what: "an array".into(),
            needed_bytes,
            limit_bytes,
        },
    }
}

/// A file that is no archive of arrays.
pub(crate) fn no_archive(reason: String) -> SourceFault {
    SourceFault::bad(
        format!("it is no archive of arrays ({reason})"),
        "give the npz file that the tool wrote, whole",
    )
}
