//! The unit of length, which depth from one image sets.

use super::frontend::MonoClip;
use crate::Observer;
use m4_core::{DepthMap, median};
use m4_geometry::classical::{CameraMotion, SparseReconstruction};

/// Brings a reconstruction to metres where the networks know them; true if lengths are metres then.
pub(super) fn set_unit(mono: Option<&MonoClip>, sparse: &mut SparseReconstruction, observer: &dyn Observer) -> bool {
    let Some(maps) = mono.and_then(|mono| mono.metric_m.as_deref()) else { return false };
    if sparse.camera_motion != CameraMotion::Parallax {
        return false;
    }
    let ratio = depth_ratio(sparse, maps);
    match ratio {
        Ok(ratio) => *sparse = rescale(sparse, ratio),
        Err(found) => observer.warn(&format!(
            "lengths stay without unit: the depth maps know only {found} of the points that were reconstructed, {NEEDED} are needed"
        )),
    }
    ratio.is_ok()
}

/// A length, in the unit of the cameras, about which the scene is away: dense settings expect 1.
pub(super) fn unit(mono: Option<&MonoClip>, sparse: &SparseReconstruction) -> f64 {
    mono.and_then(|mono| mono.metric_m.as_deref()).map_or(1.0, |maps| typical_depth(sparse, maps))
}

/// Fewest points whose depth must be known.
const NEEDED: usize = 30;

/// The reconstruction with all lengths times `by`.
pub(super) fn rescale(sparse: &SparseReconstruction, by: f64) -> SparseReconstruction {
    let mut scaled = sparse.clone();
    for camera in &mut scaled.cameras {
        camera.c2w.translation *= by;
    }
    for point in scaled.tracks.iter_mut().filter_map(|t| t.point.as_mut()) {
        *point *= by;
    }
    scaled
}

/// Depth of the maps over reconstructed depth, the median over all sightings of points; the number of points with depth if these are too
/// few.
fn depth_ratio(sparse: &SparseReconstruction, depth: &[DepthMap]) -> Result<f64, usize> {
    let mut ratios = Vec::new();
    let mut found = 0;
    for track in &sparse.tracks {
        let Some(point) = track.point else { continue };
        let before = ratios.len();
        for (frame, seen) in (track.first_frame..).zip(&track.observations) {
            let (Some(camera), Some(map)) = (sparse.cameras.get(frame), depth.get(frame)) else {
                break;
            };
            let k = &camera.intrinsics;
            let cell = |at: f32, side: usize, cells: usize| {
                let at = (f64::from(at) + 0.5) / side as f64 * cells as f64;
                (at.max(0.0) as usize).min(cells.saturating_sub(1))
            };
            let given = map[(cell(seen[0], k.width, map.width()), cell(seen[1], k.height, map.height()))];
            let (_, z) = camera.project(&point);
            if given > 0.0 && given.is_finite() && z > 0.0 {
                ratios.push(f64::from(given) / z);
            }
        }
        found += usize::from(ratios.len() > before);
    }
    match median(&mut ratios) {
        Some(ratio) if found >= NEEDED => Ok(ratio),
        _ => Err(found),
    }
}

/// How far away the scene is: the median depth of all sightings of points, or else of the maps; 1 without either.
fn typical_depth(sparse: &SparseReconstruction, maps: &[DepthMap]) -> f64 {
    let mut depths = Vec::new();
    for track in &sparse.tracks {
        let Some(point) = track.point else { continue };
        let cameras = sparse.cameras.iter().skip(track.first_frame).take(track.observations.len());
        depths.extend(cameras.map(|c| c.project(&point).1).filter(|z| *z > 0.0));
    }
    if depths.is_empty() {
        depths.extend(maps.iter().flat_map(|d| d.data()).filter(|z| **z > 0.0).map(|&z| f64::from(z)));
    }
    median(&mut depths).unwrap_or(1.0)
}
