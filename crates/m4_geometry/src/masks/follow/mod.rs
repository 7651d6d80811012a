//! Following by optical flow, with a segmenter of single images or without.
//!
//! ```text
//! mask of frame t --flow, there and back--> carried to t + 1 --edges of t + 1--> carried mask
//!   carried mask --box, points, belief--> Segmenter --plausible?--> its mask, else the carried one
//! ```
//!
//! Without a segmenter nothing holds a mask to its thing but the edges of the frames: masks drift, and grow over what looks alike, within tens of
//! frames. A thing of which too little arrives is lost for good: nothing here remembers what it looks like. Source: mask propagation by
//! flow is old; the rule when to believe a segmenter is that of `dense::segment`.

mod warp;

use super::source::{
    FrameSource, ObjectId, ObjectMask, ObjectPrompt, VideoError, VideoSegmenter, VideoSession, Visibility, read, scaled,
};
use crate::classical::dense::{
    FlowPair, FlowSource, LEAST_OVERLAP, LEAST_PART_PX, LEAST_QUALITY, ScaledFrame, SegmentError, SegmentMask,
    SegmentPrompt, Segmenter, checked_masks, prompt, working_size,
};
use m4_core::{CompactMask, Progress, RgbImage};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use warp::{Step, carry, snap};

/// Carries masks along optical flow. Where there is a segmenter of single images, it says what they mean in each frame.
pub struct FlowFollower<'a> {
    flow: &'a dyn FlowSource,
    segmenter: Option<&'a dyn Segmenter>,
    name: String,
}

impl<'a> FlowFollower<'a> {
    /// Follows by flow of `flow`; `segmenter` may outline things in each frame.
    #[must_use]
    pub fn new(flow: &'a dyn FlowSource, segmenter: Option<&'a dyn Segmenter>) -> Self {
        let name = match segmenter {
            Some(segmenter) => format!("{}+{}", segmenter.name(), flow.name()),
            None => flow.name().to_owned(),
        };
        Self { flow, segmenter, name }
    }
}

impl VideoSegmenter for FlowFollower<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn remembers(&self) -> bool {
        false
    }

    fn open<'b>(
        &'b self,
        clip: &'b dyn FrameSource,
        size: (usize, usize),
    ) -> Result<Box<dyn VideoSession + 'b>, VideoError> {
        Ok(Box::new(Session { follower: self, clip, size, known: BTreeMap::new() }))
    }
}

/// A mask, and how far the segmenter trusts it where one was asked.
type Trusted = (CompactMask, Option<f32>);

/// Where logits are above 0.
fn above(logits: &[f32], (width, height): (usize, usize)) -> CompactMask {
    CompactMask::from_fn(width, height, |x, y| logits[y * width + x] > 0.0)
}

/// The prompt that a mask is for the next frame.
fn prompt_of(mask: &CompactMask) -> SegmentPrompt {
    let (w, h) = mask.size();
    prompt(w, h, |p| mask.at(p % w, p / w))
}

/// For each carried mask what the segmenter makes of it, where that is trusted and about the same thing; else the carried mask.
fn sharpened(
    segmenter: &dyn Segmenter,
    image: &RgbImage,
    size: (usize, usize),
    carried: Vec<Option<CompactMask>>,
) -> Result<Vec<Option<Trusted>>, SegmentError> {
    let asked: Vec<usize> =
        (0..carried.len()).filter(|&k| carried[k].as_ref().is_some_and(|m| m.count() >= LEAST_PART_PX)).collect();
    let prompts: Vec<SegmentPrompt> = asked.par_iter().filter_map(|&k| Some(prompt_of(carried[k].as_ref()?))).collect();
    let found = checked_masks(segmenter, image, size, &prompts)?;
    let mut out: Vec<_> = carried.into_iter().map(|mask| mask.map(|mask| (mask, None))).collect();
    for (&k, answer) in asked.iter().zip(&found) {
        if let Some((mask, quality)) = &mut out[k] {
            let sharp = above(&answer.logits, size);
            if answer.quality >= LEAST_QUALITY && overlap(&sharp, mask) >= LEAST_OVERLAP {
                *mask = sharp;
                *quality = Some(answer.quality);
            }
        }
    }
    Ok(out)
}

/// Intersection over union, 0 if neither has pixels.
fn overlap(a: &CompactMask, b: &CompactMask) -> f32 {
    let both = a.set_pixels().filter(|&(x, y)| b.at(x, y)).count();
    both as f32 / (a.count() + b.count() - both).max(1) as f32
}

/// Longest side of the images between which flow is measured, pixels; as [`crate::classical::dense::DenseConfig::working_side_px`].
const FLOW_SIDE_PX: usize = 480;
/// Steps whose flow is measured at once.
const AHEAD: usize = 8;

/// The prompts of an object, and how far it was tracked in either direction. `None` in place of a mask: lost there.
#[derive(Default)]
struct MaskHistory {
    prompted: BTreeMap<usize, CompactMask>,
    forward: Option<(usize, Option<CompactMask>)>,
    backward: Option<(usize, Option<CompactMask>)>,
}

impl MaskHistory {
    fn at(&self, frame: usize, later: bool) -> Option<Option<CompactMask>> {
        let reached = if later { &self.forward } else { &self.backward };
        match (self.prompted.get(&frame), reached) {
            (Some(mask), _) => Some(Some(mask.clone())),
            (None, Some((at, mask))) if *at == frame => Some(mask.clone()),
            _ => None,
        }
    }
}

struct Session<'a> {
    follower: &'a FlowFollower<'a>,
    clip: &'a dyn FrameSource,
    size: (usize, usize),
    known: BTreeMap<ObjectId, MaskHistory>,
}

impl Session<'_> {
    /// Flow of steps from each of `frames` to the next of them, and the images they lead to at the size of masks.
    fn steps(&self, frames: &[usize]) -> Result<Vec<(Step, ScaledFrame)>, VideoError> {
        let flow_size = working_size(self.size.0, self.size.1, FLOW_SIDE_PX);
        let small: Vec<ScaledFrame> =
            frames.par_iter().map(|&frame| scaled(self.clip, frame, flow_size)).collect::<Result<_, _>>()?;
        let one = |k: usize| {
            let pair = FlowPair::between(&small[k].flow_image(), &small[k + 1].flow_image(), self.follower.flow);
            let pair = pair.map_err(|source| VideoError::Flow { between: (frames[k], frames[k + 1]), source })?;
            let onto = scaled(self.clip, frames[k + 1], self.size)?;
            Ok((Step::new(pair, self.size), onto))
        };
        (0..frames.len().saturating_sub(1)).into_par_iter().map(one).collect()
    }

    /// The masks one step on.
    fn stepped(
        &self,
        masks: &[Option<CompactMask>],
        frame: usize,
        step: &Step,
        onto: &ScaledFrame,
    ) -> Result<Vec<Option<Trusted>>, VideoError> {
        let carried: Vec<Option<CompactMask>> =
            masks.par_iter().map(|mask| carry(mask.as_ref()?, step, onto)).collect();
        match self.follower.segmenter {
            Some(segmenter) if carried.iter().any(Option::is_some) => {
                let image = read(self.clip, frame)?;
                sharpened(segmenter, &image, self.size, carried).map_err(|source| VideoError::Segment { frame, source })
            }
            _ => Ok(carried.into_iter().map(|mask| mask.map(|mask| (mask, None))).collect()),
        }
    }
}

impl VideoSession for Session<'_> {
    fn prompt(&mut self, frame: usize, prompts: &[ObjectPrompt]) -> Result<Vec<ObjectMask>, VideoError> {
        for prompt in prompts {
            VideoError::check_prompt(prompt, self.size)?;
        }
        let image = read(self.clip, frame)?;
        let answers: Vec<(CompactMask, Option<f32>)> = match self.follower.segmenter {
            Some(segmenter) => {
                let asked: Vec<SegmentPrompt> = prompts
                    .iter()
                    .map(|p| SegmentPrompt {
                        points_px: p.on_px.clone(),
                        off_points_px: p.off_px.clone(),
                        box_px: p.box_px,
                        belief: p.belief.clone(),
                    })
                    .collect();
                let found = checked_masks(segmenter, &image, self.size, &asked)
                    .map_err(|source| VideoError::Segment { frame, source })?;
                let mask = |m: &SegmentMask| (above(&m.logits, self.size), Some(m.quality));
                found.iter().map(mask).collect()
            }
            None => {
                let scaled = ScaledFrame::new(image.as_ref(), self.size);
                let of = |p: &ObjectPrompt| (snap(&above(&p.belief, self.size), &scaled), None);
                prompts.par_iter().map(of).collect()
            }
        };
        let mut out = Vec::with_capacity(prompts.len());
        for (prompt, (mask, quality)) in prompts.iter().zip(answers) {
            let known = self.known.entry(prompt.object).or_default();
            known.prompted.insert(frame, mask.clone());
            out.push(ObjectMask {
                object: prompt.object,
                visibility: if mask.count() > 0 { Visibility::Visible } else { Visibility::Occluded },
                mask,
                quality,
            });
        }
        Ok(out)
    }

    fn set_mask(&mut self, frame: usize, object: ObjectId, mask: &CompactMask) -> Result<(), VideoError> {
        VideoError::check_frame(frame, self.clip.frames())?;
        VideoError::check_mask(object, mask, self.size)?;
        self.known.entry(object).or_default().prompted.insert(frame, mask.clone());
        Ok(())
    }

    fn forget(&mut self, object: ObjectId) {
        self.known.remove(&object);
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
            VideoError::check_frame(frame, self.clip.frames())?;
        }
        if from == to {
            return Ok(());
        }
        let later = to > from;
        let start = |&object: &ObjectId| {
            let mask = self.known.get(&object).and_then(|known| known.at(from, later));
            mask.ok_or_else(|| VideoError::unknown(object, from))
        };
        let mut masks: Vec<Option<CompactMask>> = objects.iter().map(start).collect::<Result<_, _>>()?;
        let way: Vec<usize> = if later { (from..=to).collect() } else { (to..=from).rev().collect() };
        let mut at = from;
        'way: for k in (0..way.len().saturating_sub(1)).step_by(AHEAD) {
            if progress.cancelled() {
                return Err(VideoError::Cancelled { frame: way[k + 1] });
            }
            // Nobody is left: every frame gets empty masks, without flow.
            let part = &way[k..way.len().min(k + AHEAD + 1)];
            let prompted = |object: &ObjectId| {
                let prompted = self.known.get(object).map(|known| &known.prompted);
                prompted.is_some_and(|prompted| part.iter().any(|frame| prompted.contains_key(frame)))
            };
            let gone = masks.iter().all(Option::is_none) && !objects.iter().any(prompted);
            let steps = if gone { Vec::new() } else { self.steps(part)? };
            for (j, &frame) in part.iter().enumerate().skip(1) {
                if progress.cancelled() {
                    return Err(VideoError::Cancelled { frame });
                }
                let found = match steps.get(j - 1) {
                    Some((step, onto)) => self.stepped(&masks, frame, step, onto)?,
                    None => vec![None; masks.len()],
                };
                let (prompted, size) = (&self.known, self.size);
                let found: Vec<Option<Trusted>> = found
                    .into_iter()
                    .zip(objects)
                    // What was said of a frame outranks what is found there.
                    .map(|(found, object)| match prompted.get(object).and_then(|k| k.prompted.get(&frame)) {
                        Some(mask) => Some((mask.clone(), None)),
                        None => found,
                    })
                    .collect();
                masks = found.iter().map(|m| m.as_ref().map(|(mask, _)| mask.clone())).collect();
                let shown = found.into_iter().zip(objects).map(|(found, &object)| match found {
                    Some((mask, quality)) => ObjectMask { object, mask, quality, visibility: Visibility::Visible },
                    None => ObjectMask::unseen(object, size, Visibility::Lost),
                });
                at = frame;
                if sink(frame, shown.collect()).is_break() {
                    break 'way;
                }
            }
        }
        for (object, mask) in objects.iter().zip(masks) {
            if let Some(known) = self.known.get_mut(object) {
                *(if later { &mut known.forward } else { &mut known.backward }) = Some((at, mask));
            }
        }
        Ok(())
    }
}
