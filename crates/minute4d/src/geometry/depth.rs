//! The unit of length, which depth that is known without parallax sets.

use super::frontend::MonoClip;
use crate::Refusal;
use m4_core::{DepthMap, Progress, median};
use m4_geometry::classical::{CameraMotion, SparseReconstruction};

/// Given poses and given depth whose units differ by more than this factor do not fit.
const UNITS: f64 = 1.25;

/// Brings a reconstruction to metres where the user or networks know them; true if lengths are
/// metres then. Given poses (`posed`) stay: given depth must have their unit. Refused if given
/// depth covers too few points to set the unit.
pub(super) fn set_unit(
    mono: Option<&MonoClip>,
    sparse: &mut SparseReconstruction,
    posed: bool,
    observer: &dyn Progress,
) -> Result<bool, Refusal> {
    let Some((depth_given, maps)) =
        mono.and_then(|mono| Some((mono.given, mono.metric_m.as_deref()?)))
    else {
        return Ok(false);
    };
    if sparse.camera_motion != CameraMotion::Parallax || (posed && !depth_given) {
        return Ok(depth_given);
    }
    let few = |count| {
        format!(
            "the depth maps know only {count} of the points that were reconstructed, {NEEDED} are needed"
        )
    };
    match depth_ratio(sparse, maps) {
        Ok(ratio) if !posed => *sparse = rescale(sparse, ratio),
        Ok(ratio) if !(1.0 / UNITS..=UNITS).contains(&ratio) => observer.warn(&format!(
            "given depth and given poses have different units: points are {ratio:.3} times as far away by the depth maps (millimetres in \
             the files) as by the poses; give poses in metres"
        )),
        Err(count) if depth_given && !posed => {
            let message = format!("{}; give poses in metres too, or depth maps with fewer holes", few(count));
            return Err(Refusal::bad_input(message));
        }
        Err(count) if !depth_given => {
            observer.warn(&format!("lengths stay without unit: {}", few(count)));
            return Ok(false);
        }
        _ => {}
    }
    Ok(true)
}

/// A length, in the unit of the cameras, about which the scene is away: dense settings expect 1.
pub(super) fn unit(mono: Option<&MonoClip>, sparse: &SparseReconstruction, posed: bool) -> f64 {
    let maps = mono.and_then(|mono| mono.metric_m.as_deref());
    if posed || maps.is_some() {
        typical_depth(sparse, maps.unwrap_or_default())
    } else {
        1.0
    }
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

/// Depth of the maps over reconstructed depth, the median over all sightings of points; the number
/// of points with depth if these are too few.
fn depth_ratio(sparse: &SparseReconstruction, depth: &[DepthMap]) -> Result<f64, usize> {
    let mut ratios = Vec::new();
    let mut count = 0;
    for track in &sparse.tracks {
        let Some(point) = track.point else { continue };
        let before = ratios.len();
        for (frame, observation) in (track.first_frame..).zip(&track.observations) {
            let (Some(camera), Some(map)) = (sparse.cameras.get(frame), depth.get(frame)) else {
                break;
            };
            let k = &camera.intrinsics;
            let cell = |at: f32, side: usize, cells: usize| {
                let at = (f64::from(at) + 0.5) / side as f64 * cells as f64;
                (at.max(0.0) as usize).min(cells.saturating_sub(1))
            };
            let map_depth = map[(
                cell(observation[0], k.width, map.width()),
                cell(observation[1], k.height, map.height()),
            )];
            let (_, z) = camera.project(&point);
            if map_depth > 0.0 && map_depth.is_finite() && z > 0.0 {
                ratios.push(f64::from(map_depth) / z);
            }
        }
        count += usize::from(ratios.len() > before);
    }
    match median(&mut ratios) {
        Some(ratio) if count >= NEEDED => Ok(ratio),
        _ => Err(count),
    }
}

/// How far away the scene is: the median depth of all sightings of points, or else of the maps; 1
/// without either.
fn typical_depth(sparse: &SparseReconstruction, maps: &[DepthMap]) -> f64 {
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
        depths.extend(
            maps.iter()
                .flat_map(|d| d.data())
                .filter(|z| **z > 0.0)
                .map(|&z| f64::from(z)),
        );
    }
    median(&mut depths).unwrap_or(1.0)
}
