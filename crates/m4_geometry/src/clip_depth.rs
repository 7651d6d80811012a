//! Depth of every frame of a clip that the user or networks know, and the unit of length that it
//! sets.

use crate::classical::dense::{MonoDepth, MonoKind};
use crate::classical::sparse::SparseError;
use crate::classical::{CameraMotion, SparseReconstruction};
use crate::megasam::{DepthPrior, MegasamError, TrackingSize};
use m4_core::{DepthMap, Plane, Progress, median};

/// Depth of every frame of a clip; the maps may be smaller than the images.
#[derive(Debug)]
pub struct ClipDepth {
    /// Whether the user provided it: it is then exact where it is known.
    pub given: bool,
    /// z-depth, metres, 0 where unknown.
    pub metric_m: Option<Vec<DepthMap>>,
    /// Relative disparity.
    pub relative: Option<Vec<Plane<f32>>>,
    /// Horizontal field of view, radians: the median over the frames.
    pub fov_rad: Option<f64>,
}

/// Given poses and given depth whose units differ by more than this factor do not fit.
const UNITS: f64 = 1.25;

impl ClipDepth {
    /// Takes depth that the user provides, metres, 0 where unknown.
    #[must_use]
    pub fn given(metric_m: Vec<DepthMap>) -> Self {
        Self {
            given: true,
            metric_m: Some(metric_m),
            relative: None,
            fov_rad: None,
        }
    }

    /// Returns it as the classical front end takes it, for cameras whose unit is `unit` metres:
    /// relative disparity where both are there, as the one with better edges.
    #[must_use]
    pub fn maps(&self, unit: f64) -> Option<MonoDepth<'_>> {
        let metric = if self.given {
            MonoKind::Metric(unit as f32)
        } else {
            MonoKind::UpToScale
        };
        let relative = self.relative.as_deref().map(|maps| MonoDepth {
            kind: MonoKind::AffineDisparity,
            maps,
        });
        relative.or_else(|| {
            self.metric_m
                .as_deref()
                .map(|maps| MonoDepth { kind: metric, maps })
        })
    }

    /// Returns it as MegaSaM's tracker takes it.
    ///
    /// # Errors
    ///
    /// [`MegasamError`] where the maps hold nothing.
    pub fn prior(&self, size: &TrackingSize) -> Result<DepthPrior, MegasamError> {
        match (&self.metric_m, &self.relative) {
            (Some(metric), Some(relative)) => DepthPrior::aligned(metric, relative, size),
            (Some(metric), None) => DepthPrior::metric(metric, size),
            (None, relative) => DepthPrior::relative(relative.as_deref().unwrap_or_default(), size),
        }
    }

    /// Returns the share of the pixels whose depth in metres is known, 0..1; `None` without such
    /// maps.
    #[must_use]
    pub fn known_share(&self) -> Option<f64> {
        let all = self.metric_m.as_ref()?.iter().flat_map(|d| d.data());
        let pixels = all.clone().count().max(1) as f64;
        Some(all.filter(|&&z| z > 0.0).count() as f64 / pixels)
    }

    /// Brings a reconstruction to metres; returns true if lengths are metres then. Given poses
    /// (`posed`) stay: given depth must have their unit.
    ///
    /// # Errors
    ///
    /// [`SparseError::Input`] if given depth covers too few points to set the unit.
    pub fn set_unit(
        &self,
        sparse: &mut SparseReconstruction,
        posed: bool,
        progress: &dyn Progress,
    ) -> Result<bool, SparseError> {
        let Some(maps) = self.metric_m.as_deref() else {
            return Ok(false);
        };
        if sparse.camera_motion != CameraMotion::Parallax || (posed && !self.given) {
            return Ok(self.given);
        }
        let few = |count| {
            format!(
                "the depth maps know only {count} of the points that were reconstructed, {NEEDED} are needed"
            )
        };
        match depth_ratio(sparse, maps) {
        Ok(ratio) if !posed => *sparse = sparse.scaled(ratio),
        Ok(ratio) if !(1.0 / UNITS..=UNITS).contains(&ratio) => progress.warn(&format!(
            "given depth and given poses have different units: points are {ratio:.3} times as far away by the depth maps (millimetres in \
             the files) as by the poses; give poses in metres"
        )),
        Err(count) if self.given && !posed => {
            let message = format!("{}; give poses in metres too, or depth maps with fewer holes", few(count));
            return Err(SparseError::Input(message));
        }
        Err(count) if !self.given => {
            progress.warn(&format!("lengths stay without unit: {}", few(count)));
            return Ok(false);
        }
        _ => {}
    }
        Ok(true)
    }
}

/// Returns a length, in the unit of the cameras, about which the scene is away: dense settings
/// expect 1.
#[must_use]
pub fn unit(depth: Option<&ClipDepth>, sparse: &SparseReconstruction, posed: bool) -> f64 {
    let maps = depth.and_then(|depth| depth.metric_m.as_deref());
    if posed || maps.is_some() {
        typical_depth(sparse, maps.unwrap_or_default())
    } else {
        1.0
    }
}

/// Fewest points whose depth must be known.
const NEEDED: usize = 30;

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
