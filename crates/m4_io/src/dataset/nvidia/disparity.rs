//! Converts relative disparity of a network to depth, with the bounds of a view.

use crate::dataset::SourceErrorCause;
use crate::dataset::files::npy::NpyFile;
use crate::dataset::side::depth::known;
use m4_core::{CompactDepth, DepthMap, Plane};
use std::path::Path;

/// Largest map in memory.
const MAX_BYTES: u64 = 512 << 20;
/// Quantiles that are put on the bounds: those that LLFF takes of the points.
const QUANTILES: [f64; 2] = [0.001, 0.999];
/// Depth ends at this many times `far`.
const FARTHEST: f64 = 4.0;

/// z-depth of a map `[h][w]` of disparity up to scale and shift.
pub(super) fn depth(path: &Path, near: f64, far: f64) -> Result<CompactDepth, SourceErrorCause> {
    let array = NpyFile::read(path, MAX_BYTES)?;
    let (h, w) = array.map_size()?;
    let mut sorted: Vec<f64> = array.values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let [low, high] = QUANTILES.map(|q| quantile(&sorted, q));
    let differs = high > low;
    if !differs {
        let what = "its disparity is the same everywhere";
        return Err(SourceErrorCause::bad(
            what,
            "give maps of a network, or leave the folder disp away",
        ));
    }
    let a = (1.0 / near - 1.0 / far) / (high - low);
    let b = 1.0 / far - a * low;
    let least = 1.0 / (FARTHEST * far);
    let map: DepthMap = Plane::from_fn(w, h, |x, y| {
        let disparity = a * array.values[y * w + x] + b;
        if disparity.is_finite() {
            known((1.0 / disparity.max(least)) as f32)
        } else {
            0.0
        }
    });
    Ok(map.into())
}

/// Linear between the two nearest, NaN of nothing.
fn quantile(sorted: &[f64], q: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else {
        return f64::NAN;
    };
    let at = q * last as f64;
    let (i, part) = (at.floor() as usize, at.fract());
    sorted[i] * (1.0 - part) + sorted[(i + 1).min(last)] * part
}
