//! SAM 2 as an object tracker, and TAPIP3D as a point tracker.

use m4_core::{Camera, CompactMask, DepthMap, Plane, Progress, RgbImage};
use m4_geometry::masks::{
    FrameSource, ObjectId, ObjectMask, ObjectPrompt, VideoError, VideoSegmenter, VideoSession, Visibility,
};
use m4_geometry::tracks::{PosedClip, QueryGrid, TrackError, TrackedPoints, Tracker3d};
use m4_nets::sam2::{self, Clip as NetClip, Direction, VideoPredictor};
use m4_nets::{ClipError, NetError, PointPrompt, PointQuery, Prompt, Sam2, Sam2Size, Tapip3d, Tapip3dOptions, tapip3d};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::Arc;

/// Pixels of holes that are filled, at the size of the network's masks: upstream's on CUDA.
const HOLES_PX: usize = 8;

/// SAM 2, for any number of clips.
pub(super) struct Sam2Follower(pub Arc<Sam2>);

impl VideoSegmenter for Sam2Follower {
    fn name(&self) -> &str {
        match self.0.size() {
            Sam2Size::Tiny => "sam2.1-tiny",
            Sam2Size::Small => "sam2.1-small",
            Sam2Size::BasePlus => "sam2.1-base-plus",
            Sam2Size::Large => "sam2.1-large",
        }
    }

    fn open<'a>(
        &'a self,
        clip: &'a dyn FrameSource,
        size: (usize, usize),
    ) -> Result<Box<dyn VideoSession + 'a>, VideoError> {
        let name = self.name();
        let frames = NetClip { frames: clip.frames(), width: size.0, height: size.1 };
        let images = Box::new(move |frame| clip.image(frame).map(std::borrow::Cow::into_owned));
        let predictor = VideoPredictor::new(Arc::clone(&self.0), frames, images, HOLES_PX)
            .map_err(|error| failed(name, 0, error))?;
        Ok(Box::new(Session { predictor, name, size, frames: clip.frames() }))
    }
}

fn failed(segmenter: &str, frame: usize, error: NetError) -> VideoError {
    match error {
        NetError::Frame { frame, reason } => VideoError::Image { frame, reason },
        NetError::Cancelled => VideoError::Cancelled { frame },
        NetError::UnknownObject(object) => VideoError::unknown(ObjectId(object), frame),
        other => VideoError::Source { segmenter: segmenter.to_owned(), frame, reason: Box::new(other) },
    }
}

struct Session<'a> {
    predictor: VideoPredictor<'a>,
    name: &'a str,
    size: (usize, usize),
    frames: usize,
}

impl Session<'_> {
    /// Points as the paper asks; a box where there are none.
    fn show(&mut self, frame: usize, prompt: &ObjectPrompt) -> Result<sam2::ObjectMask, NetError> {
        let object = prompt.object.0;
        let on = prompt.on_px.iter().map(|&at_px| PointPrompt { at_px, on_object: true });
        let off = prompt.off_px.iter().map(|&at_px| PointPrompt { at_px, on_object: false });
        let prompt = Prompt {
            points: on.chain(off).collect(),
            box_px: prompt.on_px.is_empty().then_some(prompt.box_px),
            mask_logits: None,
        };
        self.predictor.show(frame, object, &prompt)
    }
}

impl VideoSession for Session<'_> {
    fn prompt(&mut self, frame: usize, prompts: &[ObjectPrompt]) -> Result<Vec<ObjectMask>, VideoError> {
        let mut out = Vec::with_capacity(prompts.len());
        for prompt in prompts {
            VideoError::check_prompt(prompt, self.size)?;
            let mask = self.show(frame, prompt).map_err(|error| failed(self.name, frame, error))?;
            out.push(converted(prompt.object, &mask, self.size));
        }
        Ok(out)
    }

    fn set_mask(&mut self, frame: usize, object: ObjectId, mask: &CompactMask) -> Result<(), VideoError> {
        VideoError::check_mask(object, mask, self.size)?;
        let plane = Plane::from_fn(self.size.0, self.size.1, |x, y| mask.at(x, y));
        let shown = self.predictor.show_mask(frame, object.0, &plane);
        shown.map(drop).map_err(|error| failed(self.name, frame, error))
    }

    fn forget(&mut self, object: ObjectId) {
        // one that was never shown is as good as forgotten
        let _ = self.predictor.remove(object.0);
    }

    fn follow(
        &mut self,
        objects: &[ObjectId],
        from: usize,
        to: usize,
        progress: &dyn Progress,
        sink: &mut dyn FnMut(usize, Vec<ObjectMask>) -> ControlFlow<()>,
    ) -> Result<(), VideoError> {
        for frame in [from, to] {
            VideoError::check_frame(frame, self.frames)?;
        }
        let (frames, direction) = match to.cmp(&from) {
            std::cmp::Ordering::Greater => (from + 1..=to, Direction::Forward),
            std::cmp::Ordering::Less => (to..=from - 1, Direction::Backward),
            std::cmp::Ordering::Equal => return Ok(()),
        };
        if objects.is_empty() {
            return Ok(());
        }
        let ids: Vec<u32> = objects.iter().map(|object| object.0).collect();
        let (name, size) = (self.name, self.size);
        let mut at = from;
        let each = |frame, found: &BTreeMap<u32, sam2::ObjectMask>| {
            at = frame;
            let ours = objects.iter().map(|&object| match found.get(&object.0) {
                Some(mask) => converted(object, mask, size),
                None => ObjectMask::unseen(object, size, Visibility::Occluded),
            });
            sink(frame, ours.collect())
        };
        let followed = self.predictor.follow_some(&ids, frames, direction, progress, each);
        followed.map_err(|error| failed(name, at, error))
    }
}

/// A mask of the network at the size of the images.
fn converted(object: ObjectId, mask: &sam2::ObjectMask, size: (usize, usize)) -> ObjectMask {
    if !mask.is_there() {
        return ObjectMask::unseen(object, size, Visibility::Occluded);
    }
    let found = mask.mask_at(size);
    let mask_px = CompactMask::from_fn(size.0, size.1, |x, y| found[(x, y)]);
    ObjectMask {
        object,
        visibility: if mask_px.count() > 0 { Visibility::Visible } else { Visibility::Occluded },
        mask: mask_px,
        quality: Some(mask.iou),
    }
}

/// Points are visible from this probability on: upstream's.
const SEEN_FROM: f32 = 0.9;
const NAME: &str = "tapip3d";

/// TAPIP3D, for any number of clips.
pub(super) struct Tapip3dTracker {
    pub net: Tapip3d,
    pub options: Tapip3dOptions,
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
        // the network's are ordered by query, ours by frame
        let count = queries.len();
        let at = |i: usize| i % count.max(1) * frames + i / count.max(1);
        let reordered = |i: usize| (found.world[at(i)], found.visibility[at(i)]);
        let (xyz, visibility) = (0..frames * count).map(reordered).unzip();
        TrackedPoints::from_probabilities(frames, queries, xyz, visibility, SEEN_FROM)
    }
}
