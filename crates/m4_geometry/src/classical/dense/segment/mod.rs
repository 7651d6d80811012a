//! Masks against what an image shows: a segmenter is asked, part by part, what the coarse mask means.
//!
//! ```text
//! coarse mask --parts--> prompt (box, points, belief) --Segmenter--> mask, quality --plausible?--> sharp mask
//! ```
//!
//! Motion finds dynamic regions but not their outline: flow is smooth across edges, a background model has the colours of the neighbours, and what lies
//! still between two legs looks like the legs. A network that knows what things look like has the outline but does not know
//! which objects are dynamic. Prompts as in Kirillov et al., "Segment Anything" (2023): a box, points and the logits of an earlier mask.
//! What prompts contain and which answers are taken was measured with MobileSAM: docs/geometry.md.

mod distance;
mod refine;

pub(crate) use distance::to_outside;
use m4_core::RgbImage;
pub(super) use refine::sharpen;

/// Parts of fewer pixels at the working size are left as they are.
pub(crate) const LEAST_PART_PX: usize = 60;
/// Points on a part: the deepest, and others far from it and from each other.
pub(crate) const POINTS: usize = 3;
/// How fast belief grows with the distance from the edge of a part, logits per pixel.
pub(crate) const BELIEF_PER_PX: f32 = 1.0;
/// The firmest belief, logits: more holds the answer closer to the coarse mask.
pub(crate) const BELIEF_LIMIT: f32 = 4.0;
/// Least quality that the segmenter expects of a mask that is taken (intersection over union).
pub(crate) const LEAST_QUALITY: f32 = 0.7;
/// Least intersection over union with the part of a mask that is taken: a far larger or smaller mask is another thing.
pub(crate) const LEAST_OVERLAP: f32 = 0.6;

/// What is known of one thing. Places are in pixels of the size that was asked for; the centre of the first pixel is (0.5, 0.5).
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentPrompt {
    /// Columns and rows of places on the thing, the surest first.
    pub points_px: Vec<[f32; 2]>,
    /// Columns and rows of places that are not on the thing.
    pub off_points_px: Vec<[f32; 2]>,
    /// Column and row of the centre of the first pixel of the thing's box, then of the last.
    pub box_px: [f32; 4],
    /// `[height][width]`, logits: above 0 where the thing is believed to be.
    pub belief: Vec<f32>,
}

/// What a segmenter makes of a prompt.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentMask {
    /// `[height][width]`: above 0 where the thing is.
    pub logits: Vec<f32>,
    /// How far the segmenter trusts the mask: its intersection with the true one over their union, as expected.
    pub quality: f32,
}

/// Why there are no masks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SegmentError {
    /// The segmenter failed.
    #[error("{segmenter} found no masks: {reason}")]
    Source {
        /// Its name.
        segmenter: String,
        /// What went wrong.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Another number of masks than of prompts, or masks of another size; the text says which.
    #[error("{0}")]
    Answer(String),
}

/// Finds the outline of what a prompt means in an image.
///
/// Called from several threads at once; the same image and prompts must give the same bits.
pub trait Segmenter: Sync {
    /// For records and messages, as `--segmenter` names it.
    fn name(&self) -> &str;

    /// A mask for every prompt, in their order. Prompts and masks are of `size` (width, height), which may be less than that of `image` but
    /// has its shape.
    ///
    /// # Errors
    ///
    /// [`SegmentError`] where the segmenter fails.
    fn masks(
        &self,
        image: &RgbImage,
        size: (usize, usize),
        prompts: &[SegmentPrompt],
    ) -> Result<Vec<SegmentMask>, SegmentError>;
}

/// The masks of `prompts`, none for none, checked for number and size.
///
/// # Errors
///
/// [`SegmentError`] where the segmenter fails or its masks do not fit.
pub(crate) fn checked_masks(
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
        let (found, expected) = (found.len(), prompts.len());
        return Err(SegmentError::Answer(format!("{found} masks for {expected} prompts")));
    }
    match found.iter().find(|mask| mask.logits.len() != size.0 * size.1) {
        Some(wrong) => Err(SegmentError::Answer(format!(
            "a mask has {} values where {} x {} were asked for",
            wrong.logits.len(),
            size.0,
            size.1
        ))),
        None => Ok(found),
    }
}

/// How much farther from each other than from the part's edge points are to lie.
const APART: f32 = 3.0;

/// The prompt for the pixels at which `part` holds, of which there is one at least.
pub(crate) fn prompt(width: usize, height: usize, part: impl Fn(usize) -> bool + Copy) -> SegmentPrompt {
    let inner = to_outside(width, height, part);
    let outer = to_outside(width, height, |p| !part(p));
    let pixels = (0..width * height).filter(|&p| part(p)).map(|p| (p % width, p / width));
    SegmentPrompt {
        points_px: points_apart(width, height, &inner, POINTS),
        off_points_px: Vec::new(),
        box_px: box_of(pixels),
        belief: belief(&inner, &outer),
    }
}

/// Column and row of the centre of the first pixel of the box around `pixels`, then of the last.
pub(crate) fn box_of(pixels: impl Iterator<Item = (usize, usize)>) -> [f32; 4] {
    let ends = pixels
        .fold([usize::MAX, usize::MAX, 0, 0], |[x0, y0, x1, y1], (x, y)| [x0.min(x), y0.min(y), x1.max(x), y1.max(y)]);
    ends.map(|v| v as f32 + 0.5)
}

/// Logits that grow by [`BELIEF_PER_PX`] with the distance from the edge of a part up to [`BELIEF_LIMIT`]; `inner` is the distance of each pixel to what is outside
/// of the part, `outer` that to the part.
pub(crate) fn belief(inner: &[f32], outer: &[f32]) -> Vec<f32> {
    let logit = |(inner, outer): (&f32, &f32)| {
        let beyond_edge_px = if *inner > 0.0 { inner - 0.5 } else { 0.5 - outer };
        (BELIEF_PER_PX * beyond_edge_px).clamp(-BELIEF_LIMIT, BELIEF_LIMIT)
    };
    inner.iter().zip(outer).map(logit).collect()
}

/// The place deepest inside (the image's border counts as an edge), then again and again the one that is both deep and far from those
/// before it; `inner` is the distance to what is outside.
pub(crate) fn points_apart(width: usize, height: usize, inner: &[f32], count: usize) -> Vec<[f32; 2]> {
    let mut depth: Vec<f32> = (0..width * height)
        .map(|p| {
            let (x, y) = (p % width, p / width);
            let border = (x + 1).min(width - x).min(y + 1).min(height - y);
            inner[p].min(border as f32)
        })
        .collect();
    let mut out = Vec::new();
    for _ in 0..count {
        let deepest = depth
            .iter()
            .enumerate()
            .fold((0, 0.0), |best: (usize, f32), (p, &d)| if d > best.1 { (p, d) } else { best });
        if deepest.1 <= 0.0 {
            break;
        }
        let (x, y) = (deepest.0 % width, deepest.0 / width);
        out.push([x as f32 + 0.5, y as f32 + 0.5]);
        for (p, d) in depth.iter_mut().enumerate() {
            let away = ((p % width) as f32 - x as f32).hypot((p / width) as f32 - y as f32);
            *d = d.min(away / APART);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{BELIEF_LIMIT, BELIEF_PER_PX, POINTS, prompt};

    #[test]
    fn prompts_hold_the_box_and_confident_points() {
        let (w, h) = (40, 30);
        // A bar of 24 x 6 pixels.
        let part = |p: usize| (8..32).contains(&(p % w)) && (10..16).contains(&(p / w));
        let found = prompt(w, h, part);
        assert_eq!(found.box_px, [8.5, 10.5, 31.5, 15.5]);
        assert_eq!(found.points_px.len(), POINTS);
        for (i, &[x, y]) in found.points_px.iter().enumerate() {
            assert!(part(y as usize * w + x as usize), "{x} {y}");
            for &[ox, oy] in &found.points_px[..i] {
                assert!((x - ox).hypot(y - oy) > 4.0, "{x} {y} {ox} {oy}");
            }
        }
        let at = |x: usize, y: usize| found.belief[y * w + x];
        assert_eq!((at(8, 12), at(7, 12)), (0.5 * BELIEF_PER_PX, -0.5 * BELIEF_PER_PX));
        assert_eq!(at(0, 0), -BELIEF_LIMIT);
        assert_eq!(at(16, 12), 2.5 * BELIEF_PER_PX);
    }
}
