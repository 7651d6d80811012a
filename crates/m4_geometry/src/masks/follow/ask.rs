//! What a segmenter of single images is asked, and when it is believed.

use crate::classical::dense::{
    LEAST_OVERLAP, LEAST_PART_PX, LEAST_QUALITY, POINTS, SegmentError, SegmentMask, SegmentPrompt, Segmenter, belief,
    points_apart, to_outside,
};
use m4_core::{CompactMask, RgbImage};
use rayon::prelude::*;

/// A mask, and how far the segmenter trusts it where one was asked.
pub type Trusted = (CompactMask, Option<f32>);

/// The masks of `prompts` in `image`, checked for number and size.
pub fn masks(
    segmenter: &dyn Segmenter,
    image: &RgbImage,
    size: (usize, usize),
    prompts: &[SegmentPrompt],
) -> Result<Vec<SegmentMask>, SegmentError> {
    if prompts.is_empty() {
        return Ok(Vec::new());
    }
    let found = segmenter.masks(image, size, prompts)?;
    if found.len() != prompts.len() {
        return Err(SegmentError::Count {
            found: found.len(),
            expected: prompts.len(),
        });
    }
    match found.iter().find(|mask| mask.logits.len() != size.0 * size.1) {
        Some(wrong) => Err(SegmentError::Size {
            found: wrong.logits.len(),
            expected: size,
        }),
        None => Ok(found),
    }
}

/// Where logits are above 0.
pub fn above(logits: &[f32], (width, height): (usize, usize)) -> CompactMask {
    CompactMask::from_fn(width, height, |x, y| logits[y * width + x] > 0.0)
}

/// The prompt that a mask is for the next frame.
pub fn prompt_of(mask: &CompactMask) -> SegmentPrompt {
    let (w, h) = mask.size();
    let inside = |p: usize| mask.at(p % w, p / w);
    let inner = to_outside(w, h, inside);
    let outer = to_outside(w, h, |p| !inside(p));
    let mut ends = [usize::MAX, usize::MAX, 0, 0];
    for (x, y) in mask.set_pixels() {
        ends = [ends[0].min(x), ends[1].min(y), ends[2].max(x), ends[3].max(y)];
    }
    SegmentPrompt {
        points_px: points_apart(w, h, &inner, POINTS),
        off_points_px: Vec::new(),
        box_px: ends.map(|v| v as f32 + 0.5),
        belief: belief(&inner, &outer),
    }
}

/// For each carried mask what the segmenter makes of it, where that is trusted and about the same thing; else the carried mask.
pub fn sharpened(
    segmenter: &dyn Segmenter,
    image: &RgbImage,
    size: (usize, usize),
    carried: Vec<Option<CompactMask>>,
) -> Result<Vec<Option<Trusted>>, SegmentError> {
    let asked: Vec<usize> = (0..carried.len())
        .filter(|&k| carried[k].as_ref().is_some_and(|m| m.count() >= LEAST_PART_PX))
        .collect();
    let prompts: Vec<SegmentPrompt> = asked
        .par_iter()
        .filter_map(|&k| Some(prompt_of(carried[k].as_ref()?)))
        .collect();
    let found = masks(segmenter, image, size, &prompts)?;
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
