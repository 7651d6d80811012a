//! SAM 2 as an object tracker, and TAPIP3D as a point tracker.

use m4_core::{Camera, CompactMask, DepthMap, Plane, Progress, RgbImage, Tracks};
use m4_geometry::masks::{InstanceError, ObjectId, ObjectMask, ObjectPrompt, VideoSession};
use m4_geometry::tracks::{CaptureClip, QueryGrid, TrackError};
use m4_nets::sam2::{self, Direction, VideoPredictor, VideoSize};
use m4_nets::{
    ClipError, NetError, PointPrompt, PointQuery, Prompt, Sam2, Sam2Size, Tapip3d, Tapip3dOptions,
    tapip3d,
};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::Arc;

/// Pixels of holes that are filled, at the size of the network's masks: upstream's on CUDA.
const HOLES_PX: usize = 8;

/// SAM 2 in `images`, with masks of `size`.
pub(super) fn sam2<'a>(
    net: Sam2,
    images: &'a [&'a RgbImage],
    size: (usize, usize),
) -> Result<Box<dyn VideoSession + 'a>, InstanceError> {
    let name = match net.size() {
        Sam2Size::Tiny => "sam2.1-tiny",
        Sam2Size::Small => "sam2.1-small",
        Sam2Size::BasePlus => "sam2.1-base-plus",
        Sam2Size::Large => "sam2.1-large",
    };
    let clip = VideoSize {
        frames: images.len(),
        width: size.0,
        height: size.1,
    };
    let read = Box::new(move |frame: usize| Ok(images[frame].clone()));
    let predictor = VideoPredictor::new(Arc::new(net), clip, read, HOLES_PX);
    Ok(Box::new(Session {
        predictor: predictor.map_err(|error| failed(name, 0, error))?,
        name,
        size,
    }))
}

fn failed(segmenter: &str, frame: usize, error: NetError) -> InstanceError {
    match error {
        NetError::Cancelled => InstanceError::Cancelled {
            phase: "tracking objects",
        },
        other => InstanceError::Source {
            segmenter: segmenter.to_owned(),
            frame,
            reason: Box::new(other),
        },
    }
}

struct Session<'a> {
    predictor: VideoPredictor<'a>,
    name: &'static str,
    size: (usize, usize),
}

impl Session<'_> {
    /// Points as the paper asks; a box where there are none.
    fn show(&mut self, frame: usize, prompt: &ObjectPrompt) -> Result<sam2::ObjectMask, NetError> {
        let object = prompt.object.0;
        let on = prompt.on_px.iter().map(|&at_px| PointPrompt {
            at_px,
            on_object: true,
        });
        let off = prompt.off_px.iter().map(|&at_px| PointPrompt {
            at_px,
            on_object: false,
        });
        let prompt = Prompt {
            points: on.chain(off).collect(),
            box_px: prompt.on_px.is_empty().then_some(prompt.box_px),
            mask_logits: None,
        };
        self.predictor.show(frame, object, &prompt)
    }
}

impl VideoSession for Session<'_> {
    fn name(&self) -> &str {
        self.name
    }

    fn prompt(
        &mut self,
        frame: usize,
        prompts: &[ObjectPrompt],
    ) -> Result<Vec<ObjectMask>, InstanceError> {
        let one = |prompt: &ObjectPrompt| {
            let mask = self
                .show(frame, prompt)
                .map_err(|error| failed(self.name, frame, error))?;
            Ok(converted(prompt.object, &mask, self.size))
        };
        prompts.iter().map(one).collect()
    }

    fn set_mask(
        &mut self,
        frame: usize,
        object: ObjectId,
        mask: &CompactMask,
    ) -> Result<(), InstanceError> {
        let plane = Plane::from_fn(self.size.0, self.size.1, |x, y| mask.at(x, y));
        let shown = self.predictor.show_mask(frame, object.0, &plane);
        shown
            .map(drop)
            .map_err(|error| failed(self.name, frame, error))
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
        sink: &mut dyn FnMut(usize, Vec<ObjectMask>),
    ) -> Result<(), InstanceError> {
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
                None => ObjectMask::unseen(object, size, false),
            });
            sink(frame, ours.collect());
            ControlFlow::Continue(())
        };
        let followed = self
            .predictor
            .follow_some(&ids, frames, direction, progress, each);
        followed.map_err(|error| failed(name, at, error))
    }
}

/// A mask of the network at the size of the images.
fn converted(object: ObjectId, mask: &sam2::ObjectMask, size: (usize, usize)) -> ObjectMask {
    if !mask.is_there() {
        return ObjectMask::unseen(object, size, false);
    }
    let pixels = mask.mask_at(size);
    let mask = CompactMask::from_fn(size.0, size.1, |x, y| pixels[(x, y)]);
    ObjectMask {
        object,
        mask,
        lost: false,
    }
}

/// Points are visible from this probability on: upstream's.
const SEEN_FROM: f32 = 0.9;
const NAME: &str = "tapip3d";

struct Frames<'a>(&'a CaptureClip<'a>);

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

/// Points that TAPIP3D follows through a clip (Minute4D Eq. 5).
pub(super) fn tapip3d(
    net: &Tapip3d,
    options: &Tapip3dOptions,
    clip: &CaptureClip<'_>,
    grid: &QueryGrid,
    progress: &dyn Progress,
) -> Result<Tracks, TrackError> {
    let frames = clip.frames();
    let queries = grid.queries(NAME, clip, progress)?;
    let asked: Vec<PointQuery> = queries
        .iter()
        .map(|query| PointQuery {
            frame: query.frame,
            world: query.xyz.map(f64::from),
        })
        .collect();
    let output = net
        .track(&Frames(clip), &asked, options, progress)
        .map_err(|error| match error {
            NetError::Cancelled => TrackError::Cancelled {
                phase: "tracking points",
            },
            other => TrackError::Source {
                tracker: NAME.to_owned(),
                reason: Box::new(other),
            },
        })?;
    // the network's are ordered by query, ours by frame
    let count = queries.len();
    let at = |i: usize| i % count.max(1) * frames + i / count.max(1);
    let (xyz, visibility): (Vec<_>, Vec<f32>) = (0..frames * count)
        .map(|i| (output.world[at(i)], output.visibility[at(i)]))
        .unzip();
    let visible = visibility.iter().map(|&p| p >= SEEN_FROM).collect();
    Ok(Tracks::new(frames, count, xyz, visible)?.with_confidence(&visibility)?)
}
