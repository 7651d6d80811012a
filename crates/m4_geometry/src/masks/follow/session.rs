//! The state of one clip.

use super::warp::{Step, carry, snap};
use super::{FlowFollower, Trusted, above, prompt_of, sharpened};
use crate::classical::dense::{FlowPair, ScaledFrame, SegmentMask, SegmentPrompt, checked_masks, working_size};
use crate::masks::source::{
    FrameSource, ObjectId, ObjectMask, ObjectPrompt, VideoError, VideoSession, Visibility, read, scaled,
};
use m4_core::{CompactMask, Progress};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::ControlFlow;

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

pub struct Session<'a> {
    follower: &'a FlowFollower<'a>,
    clip: &'a dyn FrameSource,
    size: (usize, usize),
    known: BTreeMap<ObjectId, MaskHistory>,
}

impl<'a> Session<'a> {
    pub fn new(follower: &'a FlowFollower<'a>, clip: &'a dyn FrameSource, size: (usize, usize)) -> Self {
        Self { follower, clip, size, known: BTreeMap::new() }
    }

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

    fn check(&self, object: ObjectId, found: usize) -> Result<(), VideoError> {
        if found == self.size.0 * self.size.1 {
            return Ok(());
        }
        Err(VideoError::Size { object, found, expected: self.size })
    }

    /// The mask that a prompt describes, without asking anybody: the belief, else the box.
    fn described(&self, prompt: &ObjectPrompt) -> CompactMask {
        let (w, h) = self.size;
        match (&prompt.belief, prompt.box_px) {
            (Some(belief), _) => above(belief, self.size),
            (None, Some([x0, y0, x1, y1])) => CompactMask::from_fn(w, h, |x, y| {
                let (x, y) = (x as f32 + 0.5, y as f32 + 0.5);
                x >= x0 && x <= x1 && y >= y0 && y <= y1
            }),
            // A point is a thing of a pixel: which thing, is unknown here.
            (None, None) => {
                CompactMask::from_fn(w, h, |x, y| prompt.on_px.iter().any(|p| p[0] as usize == x && p[1] as usize == y))
            }
        }
    }

    /// A prompt as a segmenter of images takes it: it has a box and a belief, too.
    fn for_image(&self, prompt: &ObjectPrompt) -> SegmentPrompt {
        let described = self.described(prompt);
        let (w, h) = self.size;
        let somewhere = if described.count() > 0 { described } else { CompactMask::from_fn(w, h, |_, _| true) };
        let of_mask = prompt_of(&somewhere);
        SegmentPrompt {
            points_px: if prompt.on_px.is_empty() { of_mask.points_px } else { prompt.on_px.clone() },
            off_points_px: prompt.off_px.clone(),
            box_px: prompt.box_px.unwrap_or(of_mask.box_px),
            belief: prompt.belief.clone().unwrap_or(of_mask.belief),
        }
    }
}

impl VideoSession for Session<'_> {
    fn prompt(&mut self, frame: usize, prompts: &[ObjectPrompt]) -> Result<Vec<ObjectMask>, VideoError> {
        for prompt in prompts {
            if let Some(belief) = &prompt.belief {
                self.check(prompt.object, belief.len())?;
            }
        }
        let image = read(self.clip, frame)?;
        let answers: Vec<(CompactMask, Option<f32>)> = match self.follower.segmenter {
            Some(segmenter) => {
                let asked: Vec<SegmentPrompt> = prompts.par_iter().map(|p| self.for_image(p)).collect();
                let found = checked_masks(segmenter, &image, self.size, &asked)
                    .map_err(|source| VideoError::Segment { frame, source })?;
                let mask = |m: &SegmentMask| (above(&m.logits, self.size), Some(m.quality));
                found.iter().map(mask).collect()
            }
            None => {
                let scaled = ScaledFrame::new(image.as_ref(), self.size);
                let of = |p: &ObjectPrompt| match p.belief {
                    Some(_) => (snap(&self.described(p), &scaled), None),
                    None => (self.described(p), None),
                };
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
        let frames = self.clip.frames();
        if frame >= frames {
            return Err(VideoError::Frame { frame, frames });
        }
        if mask.size() != self.size {
            return Err(VideoError::MaskSize { object, found: mask.size(), expected: self.size });
        }
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
        let frames = self.clip.frames();
        for frame in [from, to] {
            if frame >= frames {
                return Err(VideoError::Frame { frame, frames });
            }
        }
        if from == to {
            return Ok(());
        }
        let later = to > from;
        let start = |&object: &ObjectId| {
            let mask = self.known.get(&object).and_then(|known| known.at(from, later));
            mask.ok_or(VideoError::Unknown { object, frame: from })
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
