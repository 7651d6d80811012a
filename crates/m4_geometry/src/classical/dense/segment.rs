//! Masks against what an image shows: a segmenter is asked, part by part, what the coarse mask
//! means.
//!
//! ```text
//! coarse mask --parts--> prompt (box, points, belief) --Segmenter--> mask, quality --plausible?--> sharp mask
//! ```
//!
//! Motion finds dynamic regions but not their outline: flow is smooth across edges, a background
//! model has the colours of the neighbours, and what lies still between two legs looks like the
//! legs. A network that knows what things look like has the outline but does not know which objects
//! are dynamic. Prompts as in Kirillov et al., "Segment Anything" (2023): a box, points and the
//! logits of an earlier mask. What prompts contain and which answers are taken was measured with
//! MobileSAM: docs/geometry-log.md, "Segmenters".

use super::regions::{Components, to_outside};
use super::sources::SourceError;
use m4_core::RgbImage;

/// Parts of fewer pixels at the working size are left as they are.
pub(crate) const LEAST_PART_PX: usize = 60;
/// Points on a part: the deepest, and others far from it and from each other.
const POINTS: usize = 3;
/// How fast belief grows with the distance from the edge of a part, logits per pixel.
const BELIEF_PER_PX: f32 = 1.0;
/// The firmest belief, logits: more holds the answer closer to the coarse mask.
const BELIEF_LIMIT: f32 = 4.0;
/// Least quality that the segmenter expects of a mask that is taken (intersection over union).
pub(crate) const LEAST_QUALITY: f32 = 0.7;
/// Least intersection over union with the part of a mask that is taken: a far larger or smaller
/// mask is another thing.
pub(crate) const LEAST_OVERLAP: f32 = 0.6;

/// What is known of one thing. Places are in pixels of the size that was asked for; the centre of
/// the first pixel is (0.5, 0.5).
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
    /// How far the segmenter trusts the mask: its intersection with the true one over their union,
    /// as expected.
    pub quality: f32,
}

/// Finds the outline of what each prompt means in an image: a mask for every prompt, in their
/// order. Prompts and masks are of the size (width, height) that is given, which may be less than
/// that of the image but has its shape.
///
/// Called from several threads at once; the same image and prompts must give the same bits.
pub type Segmenter<'a> = dyn Fn(&RgbImage, (usize, usize), &[SegmentPrompt]) -> Result<Vec<SegmentMask>, SourceError>
    + Sync
    + 'a;

/// The masks of `prompts`; nothing is asked about none.
pub(crate) fn asked(
    segmenter: &Segmenter<'_>,
    image: &RgbImage,
    size: (usize, usize),
    prompts: &[SegmentPrompt],
) -> Result<Vec<SegmentMask>, SourceError> {
    if prompts.is_empty() {
        Ok(Vec::new())
    } else {
        segmenter(image, size, prompts)
    }
}

/// How much farther from each other than from the part's edge points are to lie.
const APART: f32 = 3.0;

/// The prompt for the pixels at which `part` holds, of which there is one at least.
pub(crate) fn prompt(
    width: usize,
    height: usize,
    part: impl Fn(usize) -> bool + Copy,
) -> SegmentPrompt {
    let inner = to_outside(width, height, part);
    let outer = to_outside(width, height, |p| !part(p));
    let pixels = (0..width * height)
        .filter(|&p| part(p))
        .map(|p| (p % width, p / width));
    SegmentPrompt {
        points_px: points_apart(width, height, &inner, POINTS),
        off_points_px: Vec::new(),
        box_px: box_of(pixels),
        belief: belief(&inner, &outer),
    }
}

/// Column and row of the centre of the first pixel of the box around `pixels`, then of the last.
pub(crate) fn box_of(pixels: impl Iterator<Item = (usize, usize)>) -> [f32; 4] {
    let ends = pixels.fold(
        [usize::MAX, usize::MAX, 0, 0],
        |[x0, y0, x1, y1], (x, y)| [x0.min(x), y0.min(y), x1.max(x), y1.max(y)],
    );
    ends.map(|v| v as f32 + 0.5)
}

/// Logits that grow by [`BELIEF_PER_PX`] with the distance from the edge of a part up to
/// [`BELIEF_LIMIT`]; `inner` is the distance of each pixel to what is outside of the part, `outer`
/// that to the part.
pub(crate) fn belief(inner: &[f32], outer: &[f32]) -> Vec<f32> {
    let logit = |(inner, outer): (&f32, &f32)| {
        let beyond_edge_px = if *inner > 0.0 {
            inner - 0.5
        } else {
            0.5 - outer
        };
        (BELIEF_PER_PX * beyond_edge_px).clamp(-BELIEF_LIMIT, BELIEF_LIMIT)
    };
    inner.iter().zip(outer).map(logit).collect()
}

/// The place deepest inside (the image's border counts as an edge), then again and again the one
/// that is both deep and far from those before it; `inner` is the distance to what is outside.
pub(crate) fn points_apart(
    width: usize,
    height: usize,
    inner: &[f32],
    count: usize,
) -> Vec<[f32; 2]> {
    let mut depth: Vec<f32> = (0..width * height)
        .map(|p| {
            let (x, y) = (p % width, p / width);
            let border = (x + 1).min(width - x).min(y + 1).min(height - y);
            inner[p].min(border as f32)
        })
        .collect();
    let mut out = Vec::new();
    for _ in 0..count {
        let deepest =
            depth.iter().enumerate().fold(
                (0, 0.0),
                |best: (usize, f32), (p, &d)| if d > best.1 { (p, d) } else { best },
            );
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

/// The mask of a frame: each part of `coarse` (`[height][width]` of `size`, above 0 for moving) as
/// the segmenter sees it in `image`. Parts that are small, and those of which the segmenter makes
/// something else, stay as they are.
pub(super) fn sharpen(
    segmenter: &Segmenter<'_>,
    image: &RgbImage,
    size: (usize, usize),
    coarse: &[u8],
) -> Result<Vec<u8>, SourceError> {
    let (width, height) = size;
    let parts = Components::of(width, height, coarse);
    let large: Vec<usize> = (0..parts.pixels.len())
        .filter(|&k| parts.pixels[k].len() >= LEAST_PART_PX)
        .collect();
    let of = |k: usize| prompt(width, height, |p| parts.label[p] as usize == k + 1);
    let prompts: Vec<_> = large.iter().map(|&k| of(k)).collect();
    let answers = asked(segmenter, image, size, &prompts)?;
    let masks: Vec<(usize, &SegmentMask)> = large
        .into_iter()
        .zip(&answers)
        .filter(|(k, mask)| means_the_same(mask, &parts.pixels[*k]))
        .collect();
    let mut out = coarse.to_vec();
    for &(k, _) in &masks {
        for &p in &parts.pixels[k] {
            out[p as usize] = 0;
        }
    }
    for (_, mask) in masks {
        for (out, &logit) in out.iter_mut().zip(&mask.logits) {
            if logit > 0.0 {
                *out = 255;
            }
        }
    }
    Ok(out)
}

/// Whether a mask is trusted and covers about what the part (its pixels) does.
fn means_the_same(mask: &SegmentMask, part: &[u32]) -> bool {
    let area = mask.logits.iter().filter(|&&logit| logit > 0.0).count();
    let both = part
        .iter()
        .filter(|&&p| mask.logits[p as usize] > 0.0)
        .count();
    let overlap = both as f32 / (area + part.len() - both) as f32;
    mask.quality >= LEAST_QUALITY && overlap >= LEAST_OVERLAP
}

#[cfg(test)]
mod tests {
    use super::{
        BELIEF_LIMIT, BELIEF_PER_PX, POINTS, SegmentMask, SegmentPrompt, SourceError, prompt,
        sharpen,
    };
    use m4_core::{Plane, RgbImage};

    #[test]
    fn prompts_hold_the_box_and_confident_points() {
        let (w, h) = (40, 30);
        // A bar of 24 x 6 pixels.
        let part = |p: usize| (8..32).contains(&(p % w)) && (10..16).contains(&(p / w));
        let prompt = prompt(w, h, part);
        assert_eq!(prompt.box_px, [8.5, 10.5, 31.5, 15.5]);
        assert_eq!(prompt.points_px.len(), POINTS);
        for (i, &[x, y]) in prompt.points_px.iter().enumerate() {
            assert!(part(y as usize * w + x as usize), "{x} {y}");
            for &[ox, oy] in &prompt.points_px[..i] {
                assert!((x - ox).hypot(y - oy) > 4.0, "{x} {y} {ox} {oy}");
            }
        }
        let at = |x: usize, y: usize| prompt.belief[y * w + x];
        assert_eq!(
            (at(8, 12), at(7, 12)),
            (0.5 * BELIEF_PER_PX, -0.5 * BELIEF_PER_PX)
        );
        assert_eq!(at(0, 0), -BELIEF_LIMIT);
        assert_eq!(at(16, 12), 2.5 * BELIEF_PER_PX);
    }

    const SIZE: (usize, usize) = (64, 48);

    /// Takes everything of the colour at the prompt's first point for the thing, at a quality of
    /// its red.
    fn colours(
        image: &RgbImage,
        size: (usize, usize),
        prompts: &[SegmentPrompt],
    ) -> Result<Vec<SegmentMask>, SourceError> {
        assert_eq!(image.size(), size);
        let of = |prompt: &SegmentPrompt| {
            let [x, y] = prompt.points_px[0];
            let colour = image[(x as usize, y as usize)];
            SegmentMask {
                logits: image
                    .data()
                    .iter()
                    .map(|c| if *c == colour { 3.0 } else { -3.0 })
                    .collect(),
                quality: f32::from(colour[0]) / 255.0,
            }
        };
        Ok(prompts.iter().map(of).collect())
    }

    fn disc(x: usize, y: usize, at: (i32, i32), radius: i32) -> bool {
        (x as i32 - at.0).pow(2) + (y as i32 - at.1).pow(2) <= radius * radius
    }

    const GOOD: (i32, i32) = (14, 14);
    const LARGE: (i32, i32) = (45, 24);
    const UNSURE: (i32, i32) = (14, 38);

    /// Two discs, the good one of that radius, the dull one of that red; a large thing on the
    /// right; ground.
    fn image(radius: i32, red: u8) -> RgbImage {
        Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            if disc(x, y, GOOD, radius) {
                [250, 0, 0]
            } else if disc(x, y, UNSURE, 7) {
                [red, 0, 0]
            } else if x >= 30 {
                [240, 9, 9]
            } else {
                [200, 80, 80]
            }
        })
    }

    /// The good disc moved by two pixels, a small part of the large thing, the dull disc smaller,
    /// and a speck.
    fn coarse() -> Vec<u8> {
        with_others((GOOD.0 + 2, GOOD.1))
    }

    fn with_others(good: (i32, i32)) -> Vec<u8> {
        drawn(|x, y| {
            disc(x, y, good, 8)
                || disc(x, y, LARGE, 5)
                || disc(x, y, UNSURE, 5)
                || (x, y) == (60, 2)
        })
    }

    fn drawn(covered: impl Fn(usize, usize) -> bool) -> Vec<u8> {
        let pixel = |p: usize| {
            if covered(p % SIZE.0, p / SIZE.0) {
                255
            } else {
                0
            }
        };
        (0..SIZE.0 * SIZE.1).map(pixel).collect()
    }

    #[test]
    fn fitting_masks_are_taken_and_others_ignored() {
        let actual = sharpen(&colours, &image(8, 90), SIZE, &coarse()).unwrap();
        assert!(actual == with_others(GOOD) && actual != coarse());
    }

    /// Whether `sharpen` takes the mask of the thing at `at` for a coarse mask that does not hold
    /// it.
    fn takes_mask(image: &RgbImage, coarse: &[u8], at: (usize, usize)) -> bool {
        let p = at.1 * SIZE.0 + at.0;
        assert_eq!(coarse[p], 0);
        sharpen(&colours, image, SIZE, coarse).unwrap()[p] > 0
    }

    #[test]
    fn masks_that_are_of_something_else_unsure_or_small_are_refused() {
        let (x, y) = (GOOD.0 as usize, GOOD.1 as usize);
        let shifted =
            |by: i32, radius: i32| drawn(|x, y| disc(x, y, (GOOD.0 + by, GOOD.1), radius));
        let (discs, corner) = (image(8, 90), (SIZE.0 - 1, SIZE.1 - 1));
        let (unsure, at) = (
            drawn(|x, y| disc(x, y, UNSURE, 6)),
            (UNSURE.0 as usize - 7, UNSURE.1 as usize),
        );
        for (what, image, coarse, at, wanted) in [
            ("overlap 0.7", &discs, shifted(2, 8), (x - 8, y), true),
            ("overlap 0.5", &discs, shifted(4, 8), (x - 8, y), false),
            (
                "overlap 0.05",
                &discs,
                drawn(|x, y| disc(x, y, LARGE, 5)),
                corner,
                false,
            ),
            (
                "overlap 0.98",
                &discs,
                drawn(|x, y| x >= 30 && y < SIZE.1 - 1),
                corner,
                true,
            ),
            // red over 255
            ("quality 0.71", &image(8, 181), unsure.clone(), at, true),
            ("quality 0.69", &image(8, 176), unsure, at, false),
            ("81 pixels", &image(5, 90), shifted(1, 5), (x - 5, y), true),
            ("49 pixels", &image(4, 90), shifted(1, 4), (x - 4, y), false),
        ] {
            assert_eq!(takes_mask(image, &coarse, at), wanted, "{what}");
        }
    }
}
