//! The interface of point trackers.

use super::{PosedClip, QueryGrid, TrackError};
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
        Self {
            frame,
            xyz: [p.x as f32, p.y as f32, p.z as f32],
        }
    }

    /// Refuses queries that ask about no frame of the clip or no finite place.
    ///
    /// # Errors
    ///
    /// [`TrackError::Query`] with the first one.
    pub fn check_all(queries: &[Self], frames: usize) -> Result<(), TrackError> {
        let bad = |q: &Self| q.frame >= frames || q.xyz.iter().any(|v| !v.is_finite());
        match queries.iter().position(bad) {
            Some(query) => Err(TrackError::Query {
                query,
                frame: queries[query].frame,
                frames,
                xyz: queries[query].xyz,
            }),
            None => Ok(()),
        }
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
        let tracks = tracks.map_err(|e| TrackError::Count {
            found: e.found,
            frames,
            queries: count,
        })?;
        Ok(Self { queries, tracks })
    }

    /// These and then `more`, over the same frames.
    pub(super) fn joined(self, more: Self) -> Result<Self, TrackError> {
        if self.tracks.frames() != more.tracks.frames() {
            return Err(TrackError::Count {
                found: more.tracks.xyz().len(),
                frames: self.tracks.frames(),
                queries: more.queries.len(),
            });
        }
        let frames = self.tracks.frames();
        let both = [&self.tracks, &more.tracks];
        let rows = || {
            (0..frames).flat_map(|t| {
                both.into_iter()
                    .flat_map(move |b| (0..b.count()).map(move |k| (b, t, k)))
            })
        };
        let xyz = rows().map(|(b, t, k)| b.place(t, k).unwrap_or([f32::NAN; 3])).collect();
        let visible = rows().map(|(b, t, k)| b.visible()[t * b.count() + k]).collect();
        let confidence = rows().map(|(b, t, k)| b.confidence(t, k)).collect();
        let queries = self.queries.into_iter().chain(more.queries).collect();
        Self::new(frames, queries, xyz, visible, confidence)
    }
}

/// Follows points through all frames of a clip, before and after the frame of the query.
///
/// The same clip and queries must give the same bits for any number of threads.
pub trait Tracker3d: Sync {
    /// For records and messages.
    fn name(&self) -> &str;

    /// One track a query, in their order. Places of points that cannot be seen are kept where they can be told; NaN where they
    /// cannot.
    ///
    /// # Errors
    ///
    /// [`TrackError`] where a frame cannot be read, a query asks about no place, the tracker fails, or the user stopped it.
    fn follow(
        &self,
        clip: &dyn PosedClip,
        queries: &[Query],
        progress: &dyn Progress,
    ) -> Result<TrackedPoints, TrackError>;

    /// Tracks of everything that moves: queries on a grid in the masks, in several rounds where `grid` says so.
    ///
    /// # Errors
    ///
    /// As [`follow`](Self::follow); [`TrackError::Setting`] for an unusable grid.
    fn follow_grid(
        &self,
        clip: &dyn PosedClip,
        grid: &QueryGrid,
        progress: &dyn Progress,
    ) -> Result<TrackedPoints, TrackError> {
        grid.follow_in_rounds(self.name(), clip, progress, &|queries| {
            self.follow(clip, queries, progress)
        })
    }
}
