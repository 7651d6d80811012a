//! Monocular depth of every frame.

use m4_core::{Plane, RgbImage};
use m4_geometry::classical::dense::{MonoDepth, MonoError, MonoKind, MonoMap};
#[cfg(feature = "nets")]
use m4_geometry::megasam::{DepthPrior, MegasamError, TrackingSize};
use std::borrow::Cow;

/// Depth of every frame of a clip; the maps may be smaller than the images.
pub struct MonoClip {
    pub(super) name: String,
    /// z-depth, metres, 0 where unknown.
    pub(super) metric_m: Option<Vec<Plane<f32>>>,
    /// Relative disparity.
    pub(super) relative: Option<Vec<Plane<f32>>>,
    /// Horizontal field of view, radians: the median over the frames.
    pub fov_rad: Option<f64>,
}

impl MonoClip {
    /// Depth in metres, where a network knows it.
    pub fn metric_m(&self) -> Option<&[Plane<f32>]> {
        self.metric_m.as_deref()
    }

    /// As the tracker takes it.
    ///
    /// # Errors
    ///
    /// [`MegasamError`] where the maps hold nothing.
    #[cfg(feature = "nets")]
    pub fn prior(&self, size: &TrackingSize) -> Result<DepthPrior, MegasamError> {
        match (&self.metric_m, &self.relative) {
            (Some(metric), Some(relative)) => DepthPrior::aligned(metric, relative, size),
            (Some(metric), None) => DepthPrior::metric(metric, size),
            (None, relative) => DepthPrior::relative(relative.as_deref().unwrap_or_default(), size),
        }
    }
}

/// Relative disparity goes first where both are there, as the one with better edges.
impl MonoDepth for MonoClip {
    fn name(&self) -> &str {
        &self.name
    }

    fn frames(&self) -> Option<usize> {
        self.metric_m.as_ref().or(self.relative.as_ref()).map(Vec::len)
    }

    fn depth(&self, frame: usize, _: &RgbImage) -> Result<Option<MonoMap<'_>>, MonoError> {
        let map = |kind, planes: &'_ Option<Vec<Plane<f32>>>| -> Option<MonoMap<'_>> {
            let values = planes.as_ref()?.get(frame)?;
            Some(MonoMap { kind, values: Cow::Owned(values.clone()) })
        };
        let relative = map(MonoKind::AffineDisparity, &self.relative);
        Ok(relative.or_else(|| map(MonoKind::UpToScale, &self.metric_m)))
    }
}
