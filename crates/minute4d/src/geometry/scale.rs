//! The unit of length, which given depth determines.

use super::GivenError;
use m4_core::{DepthMap, median};
use m4_geometry::classical::reconstruction::SparseReconstruction;

/// Fewest points whose depth must be given.
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

/// Given depth over reconstructed depth, the median over all sightings of points.
///
/// # Errors
///
/// [`GivenError::NoScale`] if too few points have a given depth.
pub(super) fn depth_ratio(sparse: &SparseReconstruction, depth: &[DepthMap]) -> Result<f64, GivenError> {
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
            let given = map[(
                cell(seen[0], k.width, map.width()),
                cell(seen[1], k.height, map.height()),
            )];
            let (_, z) = camera.project(&point);
            if given > 0.0 && given.is_finite() && z > 0.0 {
                ratios.push(f64::from(given) / z);
            }
        }
        found += usize::from(ratios.len() > before);
    }
    match median(&mut ratios) {
        Some(ratio) if found >= NEEDED => Ok(ratio),
        _ => Err(GivenError::NoScale { found, needed: NEEDED }),
    }
}

/// How far away the scene is: the median depth of all sightings of points, or else of what was given; 1 without either.
pub(super) fn typical_depth(sparse: &SparseReconstruction, depth: Option<&[DepthMap]>) -> f64 {
    let mut depths = Vec::new();
    for track in &sparse.tracks {
        let Some(point) = track.point else { continue };
        let cameras = sparse
            .cameras
            .iter()
            .skip(track.first_frame)
            .take(track.observations.len());
        depths.extend(cameras.map(|c| c.project(&point).1).filter(|z| *z > 0.0));
    }
    if depths.is_empty() {
        let given = depth.unwrap_or_default().iter().flat_map(|d| d.data());
        depths.extend(given.filter(|z| **z > 0.0).map(|&z| f64::from(z)));
    }
    median(&mut depths).unwrap_or(1.0)
}
