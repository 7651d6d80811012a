//! TAPIP3D as a point tracker.

use m4_core::{Camera, DepthMap, Progress, RgbImage};
use m4_geometry::tracks::{PosedClip, QueryGrid, TrackError, TrackedPoints, Tracker3d};
use m4_nets::{ClipError, NetError, PointQuery, Tapip3d, Tapip3dOptions, tapip3d};

/// Points are seen where the network thinks that at least so likely: upstream's.
const SEEN_FROM: f32 = 0.9;
const NAME: &str = "tapip3d";

/// The network, for any number of clips.
#[derive(Debug)]
pub struct Tapip3dTracker {
    net: Tapip3d,
    options: Tapip3dOptions,
}

impl Tapip3dTracker {
    /// With this network, asked in this way.
    #[must_use]
    pub fn new(net: Tapip3d, options: Tapip3dOptions) -> Self {
        Self { net, options }
    }
}

struct Frames<'a>(&'a dyn PosedClip);

impl tapip3d::PosedClip for Frames<'_> {
    fn frames(&self) -> usize {
        self.0.frames()
    }

    fn image(&self, frame: usize) -> Result<RgbImage, ClipError> {
        Ok(self.0.read(frame)?.rgb)
    }

    fn depth(&self, frame: usize) -> Result<DepthMap, ClipError> {
        Ok(self.0.read(frame)?.depth)
    }

    fn camera(&self, frame: usize) -> Result<Camera, ClipError> {
        Ok(self.0.read(frame)?.camera)
    }
}

impl Tracker3d for Tapip3dTracker {
    fn follow_grid(
        &self,
        clip: &dyn PosedClip,
        grid: &QueryGrid,
        progress: &dyn Progress,
    ) -> Result<TrackedPoints, TrackError> {
        let frames = clip.frames();
        let queries = grid.queries(NAME, clip, progress)?;
        let asked: Vec<PointQuery> =
            queries.iter().map(|query| PointQuery { frame: query.frame, world: query.xyz.map(f64::from) }).collect();
        let found = self.net.track(&Frames(clip), &asked, &self.options, progress);
        let found = found.map_err(|error| match error {
            NetError::Cancelled => TrackError::Cancelled { phase: "tracking points" },
            other => TrackError::Source { tracker: NAME.to_owned(), reason: Box::new(other) },
        })?;
        // the network's are a query's frames together, ours a frame's queries
        let count = queries.len();
        let at = |i: usize| i % count.max(1) * frames + i / count.max(1);
        let turned = |i: usize| (found.world[at(i)], found.visibility[at(i)]);
        let (xyz, visibility) = (0..frames * count).map(turned).unzip();
        TrackedPoints::from_probabilities(frames, queries, xyz, visibility, SEEN_FROM)
    }
}
