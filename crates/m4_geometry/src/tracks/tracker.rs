//! The interface of point trackers, and why points could not be followed.

use super::{PosedClip, QueryGrid};
use crate::classical::dense::FlowError;
use m4_core::{Camera, Progress, Tracks};

/// A point that is to be followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Query {
    /// The frame in which its place is known.
    pub frame: usize,
    /// Its place there, world units.
    pub xyz: [f32; 3],
}

impl Query {
    /// The point that the camera of `frame` sees at `pixel` (centre of the first one: 0, 0) at z-depth `depth`.
    #[must_use]
    pub fn at_pixel(frame: usize, camera: &Camera, pixel: [f32; 2], depth: f32) -> Self {
        let p = camera.unproject(pixel[0].into(), pixel[1].into(), depth.into());
        Self { frame, xyz: [p.x as f32, p.y as f32, p.z as f32] }
    }
}

/// Tracked points.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackedPoints {
    /// One per track, in their order.
    pub queries: Vec<Query>,
    /// Places, visibility and confidence of each in every frame; NaN where unknown.
    pub tracks: Tracks,
}

impl TrackedPoints {
    /// Converts the output of a network: positions and visibility probabilities, both `[frames][queries]`. A point is visible from `threshold` on
    /// (TAPIP3D: 0.9), and its probability is its confidence.
    ///
    /// # Errors
    ///
    /// [`TrackError::Count`] where there is not one value a frame and query.
    pub fn from_probabilities(
        frames: usize,
        queries: Vec<Query>,
        xyz: Vec<[f32; 3]>,
        probability: Vec<f32>,
        threshold: f32,
    ) -> Result<Self, TrackError> {
        let visible = probability.iter().map(|&p| p >= threshold).collect();
        Self::new(frames, queries, xyz, visible, probability)
    }

    /// Places, visibility and confidence, all `[frames][queries]`.
    ///
    /// # Errors
    ///
    /// [`TrackError::Count`] where there is not one value a frame and query.
    pub fn new(
        frames: usize,
        queries: Vec<Query>,
        xyz: Vec<[f32; 3]>,
        visible: Vec<bool>,
        confidence: Vec<f32>,
    ) -> Result<Self, TrackError> {
        let count = queries.len();
        let tracks = Tracks::new(frames, count, xyz, visible).and_then(|t| t.with_confidence(&confidence));
        let tracks = tracks.map_err(|e| TrackError::Count { found: e.found, frames, queries: count })?;
        Ok(Self { queries, tracks })
    }
}

/// Follows points through all frames of a clip, before and after the frame of the query.
///
/// The same clip and grid must give the same bits for any number of threads.
pub trait Tracker3d: Sync {
    /// Tracks of everything that moves: queries on a grid in the masks. Places of points that cannot be seen are kept where they
    /// can be told; NaN where they cannot.
    ///
    /// # Errors
    ///
    /// [`TrackError`] where a frame cannot be read, the tracker fails, or the user stopped it; [`TrackError::Setting`] for an
    /// unusable grid.
    fn follow_grid(
        &self,
        clip: &dyn PosedClip,
        grid: &QueryGrid,
        progress: &dyn Progress,
    ) -> Result<TrackedPoints, TrackError>;
}

/// Why there are no tracks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrackError {
    /// The clip could not be read.
    #[error("points cannot be tracked in frame {frame}: {reason}")]
    Frame {
        /// Which frame.
        frame: usize,
        /// What is wrong with it.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The source of flow failed.
    #[error("no flow between frames {frame} and {}", frame + 1)]
    Flow {
        /// The first of the two frames.
        frame: usize,
        /// What went wrong.
        source: FlowError,
    },
    /// The tracker failed.
    #[error("{tracker} could not track points: {reason}")]
    Source {
        /// Its name.
        tracker: String,
        /// What went wrong.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Another number of values than of frames times queries.
    #[error("{found} values for {frames} frames and {queries} queries")]
    Count {
        /// Values.
        found: usize,
        /// Frames of the clip.
        frames: usize,
        /// Queries.
        queries: usize,
    },
    /// A setting out of range.
    #[error("setting {name} is {value}; it must be {expected}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        expected: &'static str,
    },
    /// The user asked to stop.
    #[error("stopped on request while {phase}")]
    Cancelled {
        /// What was going on.
        phase: &'static str,
    },
}
