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

mod session;
mod warp;

use super::source::{FrameSource, VideoError, VideoSegmenter, VideoSession};
use crate::classical::dense::{
    FlowSource, LEAST_OVERLAP, LEAST_PART_PX, LEAST_QUALITY, SegmentError, SegmentPrompt, Segmenter, checked_masks,
    prompt,
};
use m4_core::{CompactMask, RgbImage};
use rayon::prelude::*;

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
        Ok(Box::new(session::Session::new(self, clip, size)))
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
