//! Following by optical flow, with a segmenter of single images or without.
//!
//! ```text
//! mask of frame t --flow, there and back--> carried to t + 1 --edges of t + 1--> carried mask
//!   carried mask --box, points, belief--> Segmenter --plausible?--> its mask, else the carried one
//! ```
//!
//! Without a segmenter nothing holds a mask to its thing but the edges of the frames: masks drift,
//! and grow over what looks alike, within tens of frames. A thing of which too little arrives is
//! lost for good: nothing here remembers what it looks like. Source: mask propagation by flow is
//! old; the rule when to believe a segmenter is that of `dense::segment`.

mod warp;

use super::InstanceError;
use super::source::{ObjectId, ObjectMask, ObjectPrompt, VideoSession};
use crate::classical::dense::{
    LEAST_OVERLAP, LEAST_PART_PX, LEAST_QUALITY, SegmentMask, SegmentPrompt, Segmenter,
    SourceError, asked, prompt,
};
use crate::flow::{FlowPair, ScaledFrame};
use crate::resample::working_size;
use m4_core::{CompactMask, Progress, RgbImage};
use rayon::prelude::*;
use std::collections::BTreeMap;
use warp::{carry, snap};

/// Carries masks of one clip along optical flow. Where there is a segmenter of single images, it
/// says what they mean in each frame.
pub struct FlowFollower<'a> {
    images: &'a [&'a RgbImage],
    size: (usize, usize),
    segmenter: Option<(&'a str, &'a Segmenter<'a>)>,
    histories: BTreeMap<ObjectId, MaskHistory>,
}

impl<'a> FlowFollower<'a> {
    /// Follows things in `images`, all of one size, with masks of `size`; `segmenter`, by its name,
    /// may outline them in each frame.
    #[must_use]
    pub fn new(
        images: &'a [&'a RgbImage],
        size: (usize, usize),
        segmenter: Option<(&'a str, &'a Segmenter<'a>)>,
    ) -> Self {
        Self {
            images,
            size,
            segmenter,
            histories: BTreeMap::new(),
        }
    }
}

/// Where logits are above 0.
fn above(logits: &[f32], (width, height): (usize, usize)) -> CompactMask {
    CompactMask::from_fn(width, height, |x, y| logits[y * width + x] > 0.0)
}

/// The prompt that a mask is for the next frame.
fn prompt_of(mask: &CompactMask) -> SegmentPrompt {
    let (w, h) = mask.size();
    prompt(w, h, |p| mask.at(p % w, p / w))
}

/// For each carried mask what the segmenter makes of it, where that is trusted and about the same
/// thing; else the carried mask.
fn sharpened(
    segmenter: &Segmenter<'_>,
    image: &RgbImage,
    size: (usize, usize),
    mut carried: Vec<Option<CompactMask>>,
) -> Result<Vec<Option<CompactMask>>, SourceError> {
    let large: Vec<usize> = (0..carried.len())
        .filter(|&k| {
            carried[k]
                .as_ref()
                .is_some_and(|m| m.count() >= LEAST_PART_PX)
        })
        .collect();
    let prompts: Vec<SegmentPrompt> = large
        .par_iter()
        .filter_map(|&k| Some(prompt_of(carried[k].as_ref()?)))
        .collect();
    let answers = asked(segmenter, image, size, &prompts)?;
    for (&k, answer) in large.iter().zip(&answers) {
        if let Some(mask) = &mut carried[k] {
            let sharp = above(&answer.logits, size);
            if answer.quality >= LEAST_QUALITY && overlap(&sharp, mask) >= LEAST_OVERLAP {
                *mask = sharp;
            }
        }
    }
    Ok(carried)
}

/// Intersection over union, 0 if neither has pixels.
fn overlap(a: &CompactMask, b: &CompactMask) -> f32 {
    let both = a.set_pixels().filter(|&(x, y)| b.at(x, y)).count();
    both as f32 / (a.count() + b.count() - both).max(1) as f32
}

/// Longest side of the images between which flow is measured, pixels; as
/// [`crate::classical::dense::DenseConfig::working_side_px`].
const FLOW_SIDE_PX: usize = 480;
/// Steps whose flow is measured at once.
const AHEAD: usize = 8;

/// The prompts of an object, and how far it was tracked in either direction. `None` in place of a
/// mask: lost there.
#[derive(Default)]
struct MaskHistory {
    prompted: BTreeMap<usize, CompactMask>,
    forward: Option<(usize, Option<CompactMask>)>,
    backward: Option<(usize, Option<CompactMask>)>,
}

impl MaskHistory {
    /// Its mask in a frame; `None` where it is lost there, or was neither prompted nor reached.
    fn at(&self, frame: usize, later: bool) -> Option<CompactMask> {
        let reached = if later { &self.forward } else { &self.backward };
        match (self.prompted.get(&frame), reached) {
            (Some(mask), _) => Some(mask.clone()),
            (None, Some((at, mask))) if *at == frame => mask.clone(),
            _ => None,
        }
    }
}

impl FlowFollower<'_> {
    /// Flow of steps from each of `frames` to the next of them, and the images they lead to at the
    /// size of masks.
    fn steps(&self, frames: &[usize]) -> Vec<(FlowPair, ScaledFrame)> {
        let flow_size = working_size(self.size.0, self.size.1, FLOW_SIDE_PX);
        let small: Vec<ScaledFrame> = frames
            .par_iter()
            .map(|&frame| ScaledFrame::new(self.images[frame], flow_size))
            .collect();
        let one = |k: usize| {
            let pair = FlowPair::between(&small[k], &small[k + 1]);
            (
                pair.resized(self.size),
                ScaledFrame::new(self.images[frames[k + 1]], self.size),
            )
        };
        (0..frames.len().saturating_sub(1))
            .into_par_iter()
            .map(one)
            .collect()
    }

    /// The masks one step on.
    fn stepped(
        &self,
        masks: &[Option<CompactMask>],
        frame: usize,
        step: &FlowPair,
        onto: &ScaledFrame,
    ) -> Result<Vec<Option<CompactMask>>, InstanceError> {
        let carried: Vec<Option<CompactMask>> = masks
            .par_iter()
            .map(|mask| carry(mask.as_ref()?, step, onto))
            .collect();
        match self.segmenter {
            Some((name, segmenter)) if carried.iter().any(Option::is_some) => {
                sharpened(segmenter, self.images[frame], self.size, carried)
                    .map_err(failed(name, frame))
            }
            _ => Ok(carried),
        }
    }
}

fn failed(segmenter: &str, frame: usize) -> impl Fn(SourceError) -> InstanceError {
    move |reason| InstanceError::Source {
        segmenter: segmenter.to_owned(),
        frame,
        reason,
    }
}

impl VideoSession for FlowFollower<'_> {
    fn name(&self) -> &str {
        self.segmenter.map_or("classical", |(name, _)| name)
    }

    fn remembers(&self) -> bool {
        false
    }

    fn prompt(
        &mut self,
        frame: usize,
        prompts: &[ObjectPrompt],
    ) -> Result<Vec<ObjectMask>, InstanceError> {
        let image = self.images[frame];
        let answers: Vec<CompactMask> = match self.segmenter {
            Some((name, segmenter)) => {
                let wanted: Vec<SegmentPrompt> = prompts
                    .iter()
                    .map(|p| SegmentPrompt {
                        points_px: p.on_px.clone(),
                        off_points_px: p.off_px.clone(),
                        box_px: p.box_px,
                        belief: p.belief.clone(),
                    })
                    .collect();
                let answers =
                    asked(segmenter, image, self.size, &wanted).map_err(failed(name, frame))?;
                answers
                    .iter()
                    .map(|m: &SegmentMask| above(&m.logits, self.size))
                    .collect()
            }
            None => {
                let scaled = ScaledFrame::new(image, self.size);
                prompts
                    .par_iter()
                    .map(|p| snap(&above(&p.belief, self.size), &scaled))
                    .collect()
            }
        };
        let mut out = Vec::with_capacity(prompts.len());
        for (prompt, mask) in prompts.iter().zip(answers) {
            let history = self.histories.entry(prompt.object).or_default();
            history.prompted.insert(frame, mask.clone());
            out.push(ObjectMask {
                object: prompt.object,
                mask,
                lost: false,
            });
        }
        Ok(out)
    }

    fn set_mask(
        &mut self,
        frame: usize,
        object: ObjectId,
        mask: &CompactMask,
    ) -> Result<(), InstanceError> {
        self.histories
            .entry(object)
            .or_default()
            .prompted
            .insert(frame, mask.clone());
        Ok(())
    }

    fn forget(&mut self, object: ObjectId) {
        self.histories.remove(&object);
    }

    fn follow(
        &mut self,
        objects: &[ObjectId],
        from: usize,
        to: usize,
        progress: &dyn Progress,
        sink: &mut dyn FnMut(usize, Vec<ObjectMask>),
    ) -> Result<(), InstanceError> {
        const PHASE: &str = "tracking objects";
        if from == to {
            return Ok(());
        }
        let later = to > from;
        let start = |object: &ObjectId| {
            self.histories
                .get(object)
                .and_then(|history| history.at(from, later))
        };
        let mut masks: Vec<Option<CompactMask>> = objects.iter().map(start).collect();
        let way: Vec<usize> = if later {
            (from..=to).collect()
        } else {
            (to..=from).rev().collect()
        };
        for k in (0..way.len().saturating_sub(1)).step_by(AHEAD) {
            if progress.cancelled() {
                return Err(InstanceError::Cancelled { phase: PHASE });
            }
            // Nobody is left: every frame gets empty masks, without flow.
            let part = &way[k..way.len().min(k + AHEAD + 1)];
            let prompted = |object: &ObjectId| {
                let prompted = self.histories.get(object).map(|history| &history.prompted);
                prompted
                    .is_some_and(|prompted| part.iter().any(|frame| prompted.contains_key(frame)))
            };
            let gone = masks.iter().all(Option::is_none) && !objects.iter().any(prompted);
            let steps = if gone { Vec::new() } else { self.steps(part) };
            for (j, &frame) in part.iter().enumerate().skip(1) {
                if progress.cancelled() {
                    return Err(InstanceError::Cancelled { phase: PHASE });
                }
                let answers = match steps.get(j - 1) {
                    Some((step, onto)) => self.stepped(&masks, frame, step, onto)?,
                    None => vec![None; masks.len()],
                };
                // What was said of a frame outranks what is found there.
                let said = |object| Some(self.histories.get(object)?.prompted.get(&frame)?.clone());
                masks = answers
                    .into_iter()
                    .zip(objects)
                    .map(|(mask, object)| said(object).or(mask))
                    .collect();
                let shown = masks.iter().zip(objects).map(|(mask, &object)| match mask {
                    Some(mask) => ObjectMask {
                        object,
                        mask: mask.clone(),
                        lost: false,
                    },
                    None => ObjectMask::unseen(object, self.size, true),
                });
                sink(frame, shown.collect());
            }
        }
        for (object, mask) in objects.iter().zip(masks) {
            if let Some(history) = self.histories.get_mut(object) {
                *(if later {
                    &mut history.forward
                } else {
                    &mut history.backward
                }) = Some((to, mask));
            }
        }
        Ok(())
    }
}
