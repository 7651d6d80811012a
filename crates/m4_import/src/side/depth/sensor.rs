//! Depth of a sensor, and how sure it was of it.

use super::read_depth;
use crate::core::SourceFault;
use crate::files::pictures::size_of;
use m4_io::image;
use m4_scene::{CompactDepth, Plane};
use std::path::Path;

/// Depth where `confidence`, a greyscale picture of the same size, is above 0, or all of it where there is no such file.
pub(crate) fn read_sensed(depth: &Path, confidence: &Path, unit: f64) -> Result<CompactDepth, SourceFault> {
    let map = read_depth(depth, unit).map_err(|fault| fault.of_file(depth))?;
    if !confidence.is_file() {
        return Ok(map);
    }
    size_of(confidence)?;
    let confidence_map = image::read_grey(confidence)?;
    kept_where(&map, &confidence_map).map_err(|fault| fault.of_file(confidence))
}

/// Depth where `confidence` of the same size is above 0, unknown elsewhere.
pub(crate) fn kept_where(depth: &CompactDepth, confidence: &Plane<u8>) -> Result<CompactDepth, SourceFault> {
    if depth.size() != confidence.size() {
        let (d, c) = (depth.size(), confidence.size());
        let what = format!(
            "a confidence map of {} x {} pixels for depth of {} x {}",
            c.0, c.1, d.0, d.1
        );
        return Err(SourceFault::bad(what, "export both again"));
    }
    let (w, h) = depth.size();
    let kept = Plane::from_fn(w, h, |x, y| if confidence[(x, y)] > 0 { depth.at(x, y) } else { 0.0 });
    Ok(CompactDepth::from(kept))
}
