//! Depth that is known without parallax, and the unit of length that it sets.

use super::frontend::MonoClip;
use super::given::Given;
use super::scale::{depth_ratio, rescale, typical_depth};
use crate::{Error, Observer};
use m4_core::DepthMap;
use m4_geometry::classical::reconstruction::{CameraMotion, SparseReconstruction};

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

    /// Brings a reconstruction to the unit of the known depth; true if lengths are metres then. Given poses (`posed`) keep theirs.
    ///
    /// # Errors
    ///
    /// [`super::GivenError::NoScale`] if given depth covers too few points.
    pub fn set_unit(
        &self,
        sparse: &mut SparseReconstruction,
        posed: bool,
        observer: &dyn Observer,
    ) -> Result<bool, Error> {
        let parallax = sparse.camera_motion == CameraMotion::Parallax;
        match self {
            Self::Given(maps) => {
                if parallax {
                    to_metres(sparse, maps, posed, observer)?;
                }
                Ok(true)
            }
            Self::Network(mono) => match mono.metric_m().filter(|_| parallax && !posed) {
                Some(maps) => match depth_ratio(sparse, maps) {
                    Ok(ratio) => {
                        *sparse = rescale(sparse, ratio);
                        Ok(true)
                    }
                    Err(error) => {
                        observer.warn(&format!("lengths stay without unit: {error}"));
                        Ok(false)
                    }
                },
                None => Ok(false),
            },
            Self::Unknown => Ok(false),
        }
    }

    /// A length, in the unit of the cameras, about which the scene is away: dense settings expect 1.
    pub fn unit(&self, sparse: &SparseReconstruction, posed: bool) -> f64 {
        let maps = match self {
            Self::Given(maps) => Some(*maps),
            Self::Network(mono) => mono.metric_m(),
            Self::Unknown => None,
        };
        if posed || maps.is_some() {
            typical_depth(sparse, maps)
        } else {
            1.0
        }
    }
}

/// Brings a reconstruction of any unit to that of the given depth. Given poses stay: they must have that unit.
fn to_metres(
    sparse: &mut SparseReconstruction,
    depth: &[DepthMap],
    posed: bool,
    observer: &dyn Observer,
) -> Result<(), Error> {
    let ratio = depth_ratio(sparse, depth)?;
    if !posed {
        *sparse = rescale(sparse, ratio);
    } else if !(1.0 / UNITS..=UNITS).contains(&ratio) {
        observer.warn(&format!(
            "given depth and given poses have different units: points are {ratio:.3} times as far away by the depth maps \
             (millimetres in the files) as by the poses; give poses in metres"
        ));
    }
    Ok(())
}
