//! Sensor depth with its confidence.

use crate::dataset::SourceErrorCause;
use m4_core::{CompactDepth, Plane};

/// Depth where `confidence` of the same size is above 0, unknown elsewhere.
pub(crate) fn kept_where(depth: &CompactDepth, confidence: &Plane<u8>) -> Result<CompactDepth, SourceErrorCause> {
    if depth.size() != confidence.size() {
        let (d, c) = (depth.size(), confidence.size());
        let what = format!(
            "a confidence map of {} x {} pixels for depth of {} x {}",
            c.0, c.1, d.0, d.1
        );
        return Err(SourceErrorCause::bad(what, "export both again"));
    }
    let (w, h) = depth.size();
    let kept = Plane::from_fn(w, h, |x, y| if confidence[(x, y)] > 0 { depth.at(x, y) } else { 0.0 });
    Ok(CompactDepth::from(kept))
}
