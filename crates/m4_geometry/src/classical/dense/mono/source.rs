//! What gives depth from one image.

use m4_core::{DepthMap, Plane, RgbImage};
use std::borrow::Cow;

/// What the values of a map are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MonoKind {
    /// z-depth in the unit of the cameras; 0, or not finite, where unknown.
    Metric,
    /// z-depth up to one factor per frame; 0, or not finite, where unknown.
    UpToScale,
    /// One over z-depth up to a factor above 0 and a shift per frame; not finite where unknown.
    AffineDisparity,
}

/// Depth of one frame, `[height][width]`, of any size of the same shape: it is read at the nearest pixel.
#[derive(Debug, Clone)]
pub struct MonoMap<'a> {
    /// What the values are.
    pub kind: MonoKind,
    /// The values.
    pub values: Cow<'a, Plane<f32>>,
}

/// Why there is no depth.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MonoError {
    /// The source failed.
    #[error("{source_name} found no depth: {reason}")]
    Source {
        /// Its name.
        source_name: String,
        /// What went wrong.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A map without pixels.
    #[error("the depth map is empty; give one of the shape of the frame")]
    Empty,
}

/// Knows depth from one image: a sensor, a network, another program's result.
///
/// Called from several threads at once; the same image must give the same bits.
pub trait MonoDepth: Send + Sync {
    /// For records and messages.
    fn name(&self) -> &str;

    /// For how many frames it has depth; `None` for any number.
    fn frames(&self) -> Option<usize> {
        None
    }

    /// Depth of frame `frame`, which is `image`; `None` where it is unknown. All maps of a clip are of one kind.
    ///
    /// # Errors
    ///
    /// [`MonoError`] where the source fails.
    fn depth(&self, frame: usize, image: &RgbImage) -> Result<Option<MonoMap<'_>>, MonoError>;
}

/// Knows nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoDepth;

impl MonoDepth for NoDepth {
    fn name(&self) -> &'static str {
        "none"
    }

    fn depth(&self, _: usize, _: &RgbImage) -> Result<Option<MonoMap<'_>>, MonoError> {
        Ok(None)
    }
}

/// What a sensor measured: a plane per frame, z-depth in the unit of the cameras, 0 where unknown.
#[derive(Debug, Clone)]
pub struct SensorDepth {
    /// One per frame.
    pub maps: Vec<DepthMap>,
}

impl MonoDepth for SensorDepth {
    fn name(&self) -> &'static str {
        "sensor"
    }

    fn frames(&self) -> Option<usize> {
        Some(self.maps.len())
    }

    fn depth(&self, frame: usize, _: &RgbImage) -> Result<Option<MonoMap<'_>>, MonoError> {
        Ok(self.maps.get(frame).map(|map| MonoMap {
            kind: MonoKind::Metric,
            values: Cow::Borrowed(map),
        }))
    }
}
