//! The dynamic objects of a frame, as lists of pixels: instances where the frame has them, else
//! connected regions of its mask.

use m4_core::{CaptureFrame, covering};
use std::collections::BTreeMap;

/// Connected regions with fewer pixels are noise.
const LEAST_PIXELS: usize = 40;

/// The number of an object, the same in all frames, and its pixels `(x, y)` in the image. Regions
/// of a mask have the number 0.
pub(super) fn regions(frame: &CaptureFrame) -> Vec<(u16, Vec<(usize, usize)>)> {
    let (w, h) = frame.rgb.size();
    if let Some(ids) = &frame.instances {
        let ids = ids.to_plane();
        let mut objects: BTreeMap<u16, Vec<(usize, usize)>> = BTreeMap::new();
        for (x, y) in (0..w * h).map(|i| (i % w, i / w)) {
            let id = ids[covering((x, y), (w, h), ids.size())];
            if id != 0 {
                objects.entry(id).or_default().push((x, y));
            }
        }
        return objects.into_iter().collect();
    }
    let Some(mask) = &frame.mask else {
        return Vec::new();
    };
    let mut rest: Vec<bool> = (0..w * h)
        .map(|i| mask.covers((i % w, i / w), (w, h)))
        .collect();
    let mut regions = Vec::new();
    for start in 0..w * h {
        if !std::mem::take(&mut rest[start]) {
            continue;
        }
        let (mut pixels, mut next) = (vec![(start % w, start / w)], 0);
        while let Some(&(x, y)) = pixels.get(next) {
            next += 1;
            for v in y.saturating_sub(1)..(y + 2).min(h) {
                for u in x.saturating_sub(1)..(x + 2).min(w) {
                    if std::mem::take(&mut rest[v * w + u]) {
                        pixels.push((u, v));
                    }
                }
            }
        }
        if pixels.len() >= LEAST_PIXELS {
            regions.push((0, pixels));
        }
    }
    regions
}
