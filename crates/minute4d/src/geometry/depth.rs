//! Depth that is known without parallax, and the unit of length that it sets.

use super::frontend::MonoClip;
use super::given::Given;
use crate::{Error, Observer, Refusal};
use m4_core::{DepthMap, median};
use m4_geometry::classical::{CameraMotion, SparseReconstruction};

/// Given poses and given depth whose units differ by more than this factor do not fit.
const UNITS: f64 = 1.25;

/// Where depth without parallax comes from.
pub(super) enum KnownDepth<'a> {
    /// The user, metres.
    Given(&'a [DepthMap]),
    /// Networks.
    Network(MonoClip),
    /// Nowhere.
    Unknown,
}

impl<'a> KnownDepth<'a> {
    /// Depth that the user provides goes before that of networks.
    pub fn of(given: &'a Given, mono: Option<MonoClip>) -> Self {
        match (given.depth.as_deref(), mono) {
            (Some(maps), _) => Self::Given(maps),
            (None, Some(mono)) => Self::Network(mono),
            (None, None) => Self::Unknown,
        }
    }

    /// Horizontal field of view that a network found, radians.
    pub fn fov_rad(&self) -> Option<f64> {
        match self {
            Self::Network(mono) => mono.fov_rad,
            Self::Given(_) | Self::Unknown => None,
        }
    }

    /// Brings a reconstruction to the unit of the known depth; true if lengths are metres then. Given poses (`posed`) stay: they must have
    /// that unit. Refused if given depth covers too few points.
    pub fn set_unit(
        &self,
        sparse: &mut SparseReconstruction,
        posed: bool,
        observer: &dyn Observer,
    ) -> Result<bool, Error> {
        let parallax = sparse.camera_motion == CameraMotion::Parallax;
        match self {
            Self::Given(_) if !parallax => Ok(true),
            Self::Given(maps) => {
                let ratio = depth_ratio(sparse, maps)?;
                if !posed {
                    *sparse = rescale(sparse, ratio);
                } else if !(1.0 / UNITS..=UNITS).contains(&ratio) {
                    observer.warn(&format!(
                        "given depth and given poses have different units: points are {ratio:.3} times as far away by the depth maps \
                         (millimetres in the files) as by the poses; give poses in metres"
                    ));
                }
                Ok(true)
            }
            Self::Network(MonoClip { metric_m: Some(maps), .. }) if parallax && !posed => {
                let ratio = depth_ratio(sparse, maps);
                match &ratio {
                    Ok(ratio) => *sparse = rescale(sparse, *ratio),
                    Err(error) => observer.warn(&format!("lengths stay without unit: {error}")),
                }
                Ok(ratio.is_ok())
            }
            Self::Network(_) | Self::Unknown => Ok(false),
        }
    }

    /// A length, in the unit of the cameras, about which the scene is away: dense settings expect 1.
    pub fn unit(&self, sparse: &SparseReconstruction, posed: bool) -> f64 {
        let maps = match self {
            Self::Given(maps) => Some(*maps),
            Self::Network(mono) => mono.metric_m.as_deref(),
            Self::Unknown => None,
        };
        if posed || maps.is_some() { typical_depth(sparse, maps) } else { 1.0 }
    }
}

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

/// Given depth over reconstructed depth, the median over all sightings of points; refused if too few points have a given depth.
pub(super) fn depth_ratio(sparse: &SparseReconstruction, depth: &[DepthMap]) -> Result<f64, Refusal> {
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
        _ => Err(Refusal::bad_input(format!(
            "the depth maps know only {found} of the points that were reconstructed, {NEEDED} are needed to bring both to one scale; give \
             --poses in metres too, or depth maps with fewer holes"
        ))),
    }
}

/// How far away the scene is: the median depth of all sightings of points, or else of what was given; 1 without either.
pub(super) fn typical_depth(sparse: &SparseReconstruction, depth: Option<&[DepthMap]>) -> f64 {
    let mut depths = Vec::new();
    for track in &sparse.tracks {
        let Some(point) = track.point else { continue };
        let cameras = sparse.cameras.iter().skip(track.first_frame).take(track.observations.len());
        depths.extend(cameras.map(|c| c.project(&point).1).filter(|z| *z > 0.0));
    }
    if depths.is_empty() {
        let given = depth.unwrap_or_default().iter().flat_map(|d| d.data());
        depths.extend(given.filter(|z| **z > 0.0).map(|&z| f64::from(z)));
    }
    median(&mut depths).unwrap_or(1.0)
}
