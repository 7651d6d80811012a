//! The masks of a segmenter in place of coarse ones, where they mean the same thing.

use super::super::components::Components;
use super::{LEAST_OVERLAP, LEAST_PART_PX, LEAST_QUALITY, SegmentError, SegmentMask, Segmenter, checked_masks, prompt};
use m4_core::RgbImage;

/// The mask of a frame: each part of `coarse` (`[height][width]` of `size`, above 0 for moving) as the segmenter sees it in `image`. Parts
/// that are small, and those of which the segmenter makes something else, stay as they are.
///
/// # Errors
///
/// [`SegmentError`] where the segmenter fails or its masks do not fit.
pub fn sharpen(
    segmenter: &dyn Segmenter,
    image: &RgbImage,
    size: (usize, usize),
    coarse: &[u8],
) -> Result<Vec<u8>, SegmentError> {
    let (width, height) = size;
    let parts = Components::of(width, height, coarse);
    let large: Vec<usize> = (0..parts.pixels.len()).filter(|&k| parts.pixels[k].len() >= LEAST_PART_PX).collect();
    let of = |k: usize| prompt(width, height, |p| parts.label[p] as usize == k + 1);
    let prompts: Vec<_> = large.iter().map(|&k| of(k)).collect();
    let found = checked_masks(segmenter, image, size, &prompts)?;
    let taken: Vec<(usize, &SegmentMask)> =
        large.into_iter().zip(&found).filter(|(k, mask)| means_the_same(mask, &parts.pixels[*k])).collect();
    let mut out = coarse.to_vec();
    for &(k, _) in &taken {
        for &p in &parts.pixels[k] {
            out[p as usize] = 0;
        }
    }
    for (_, mask) in taken {
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
    let both = part.iter().filter(|&&p| mask.logits[p as usize] > 0.0).count();
    let overlap = both as f32 / (area + part.len() - both) as f32;
    mask.quality >= LEAST_QUALITY && overlap >= LEAST_OVERLAP
}

#[cfg(test)]
mod tests {
    use super::sharpen;
    use crate::classical::dense::segment::{SegmentError, SegmentMask, SegmentPrompt, Segmenter};
    use m4_core::{Plane, RgbImage};

    const SIZE: (usize, usize) = (64, 48);

    /// Takes everything of the colour at the prompt's first point for the thing, at a quality of its red.
    struct Colours;

    impl Segmenter for Colours {
        fn name(&self) -> &str {
            "colours"
        }

        fn masks(
            &self,
            image: &RgbImage,
            size: (usize, usize),
            prompts: &[SegmentPrompt],
        ) -> Result<Vec<SegmentMask>, SegmentError> {
            assert_eq!(image.size(), size);
            let of = |prompt: &SegmentPrompt| {
                let [x, y] = prompt.points_px[0];
                let colour = image[(x as usize, y as usize)];
                SegmentMask {
                    logits: image.data().iter().map(|c| if *c == colour { 3.0 } else { -3.0 }).collect(),
                    quality: f32::from(colour[0]) / 255.0,
                }
            };
            Ok(prompts.iter().map(of).collect())
        }
    }

    struct Wrong(usize, usize);

    impl Segmenter for Wrong {
        fn name(&self) -> &str {
            "wrong"
        }

        fn masks(
            &self,
            _: &RgbImage,
            _: (usize, usize),
            _: &[SegmentPrompt],
        ) -> Result<Vec<SegmentMask>, SegmentError> {
            let mask = SegmentMask { logits: vec![0.0; self.1], quality: 1.0 };
            Ok(vec![mask; self.0])
        }
    }

    fn disc(x: usize, y: usize, at: (i32, i32), radius: i32) -> bool {
        (x as i32 - at.0).pow(2) + (y as i32 - at.1).pow(2) <= radius * radius
    }

    const GOOD: (i32, i32) = (14, 14);
    const LARGE: (i32, i32) = (45, 24);
    const UNSURE: (i32, i32) = (14, 38);

    /// Two discs, one of them dull; a large thing on the right; ground.
    fn two_discs() -> RgbImage {
        image(8, 90)
    }

    /// The same with other values of the radius of the good disc and the red of the dull one.
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

    /// The good disc moved by two pixels, a small part of the large thing, the dull disc smaller, and a speck.
    fn coarse() -> Vec<u8> {
        drawn(|x, y| {
            disc(x, y, (GOOD.0 + 2, GOOD.1), 8) || disc(x, y, LARGE, 5) || disc(x, y, UNSURE, 5) || (x, y) == (60, 2)
        })
    }

    fn drawn(covered: impl Fn(usize, usize) -> bool) -> Vec<u8> {
        let pixel = |p: usize| if covered(p % SIZE.0, p / SIZE.0) { 255 } else { 0 };
        (0..SIZE.0 * SIZE.1).map(pixel).collect()
    }

    #[test]
    fn fitting_masks_are_taken_and_others_ignored() {
        let found = sharpen(&Colours, &two_discs(), SIZE, &coarse()).unwrap();
        for (p, &m) in found.iter().enumerate() {
            let (x, y) = (p % SIZE.0, p / SIZE.0);
            let wanted = disc(x, y, GOOD, 8) || disc(x, y, LARGE, 5) || disc(x, y, UNSURE, 5) || (x, y) == (60, 2);
            assert_eq!(m, if wanted { 255 } else { 0 }, "column {x}, row {y}");
        }
        assert_ne!(found, coarse());
    }

    /// Whether `sharpen` takes the mask of the thing at `at` for a coarse mask that does not hold it.
    fn taken(image: &RgbImage, coarse: &[u8], at: (usize, usize)) -> bool {
        let p = at.1 * SIZE.0 + at.0;
        assert_eq!(coarse[p], 0);
        sharpen(&Colours, image, SIZE, coarse).unwrap()[p] > 0
    }

    #[test]
    fn masks_that_are_of_something_else_unsure_or_small_are_refused() {
        let (x, y) = (GOOD.0 as usize, GOOD.1 as usize);
        let shifted = |by: i32, radius: i32| drawn(|x, y| disc(x, y, (GOOD.0 + by, GOOD.1), radius));
        let (discs, corner) = (two_discs(), (SIZE.0 - 1, SIZE.1 - 1));
        let (unsure, at) = (drawn(|x, y| disc(x, y, UNSURE, 6)), (UNSURE.0 as usize - 7, UNSURE.1 as usize));
        for (what, image, coarse, at, wanted) in [
            ("overlap 0.7", &discs, shifted(2, 8), (x - 8, y), true),
            ("overlap 0.5", &discs, shifted(4, 8), (x - 8, y), false),
            ("overlap 0.05", &discs, drawn(|x, y| disc(x, y, LARGE, 5)), corner, false),
            ("overlap 0.98", &discs, drawn(|x, y| x >= 30 && y < SIZE.1 - 1), corner, true),
            // red over 255
            ("quality 0.71", &image(8, 181), unsure.clone(), at, true),
            ("quality 0.69", &image(8, 176), unsure, at, false),
            ("81 pixels", &image(5, 90), shifted(1, 5), (x - 5, y), true),
            ("49 pixels", &image(4, 90), shifted(1, 4), (x - 4, y), false),
        ] {
            assert_eq!(taken(image, &coarse, at), wanted, "{what}");
        }
    }

    #[test]
    fn answers_that_do_not_fit_are_errors() {
        let of = |wrong| sharpen(&wrong, &two_discs(), SIZE, &coarse()).unwrap_err().to_string();
        assert_eq!(of(Wrong(2, 64 * 48)), "2 masks for 3 prompts");
        assert!(of(Wrong(3, 5)).contains("5 values where 64 x 48"));
    }
}
