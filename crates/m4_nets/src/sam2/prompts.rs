//! What is asked for, checked and encoded.

use super::Sam2Error;
use crate::ops::{IMAGENET_MEAN, IMAGENET_STD, Kernels, planes, resampled, tensor};
use crate::sam::{Prompt, PromptEncoder};
use burn_core::tensor::{Device, Tensor};
use m4_core::{Plane, ResizeFilter, RgbImage, resize_rgb};

/// Tokens `[n, 256]` of `prompt` in an image of the size `frame`: the box's corners, the points, and one that is no place; two of those
/// where there are neither.
///
/// # Errors
///
/// [`Sam2Error`] if a place is not in the image or the box is reversed.
pub fn tokens(encoder: &PromptEncoder, prompt: &Prompt, frame: Frame, side: usize) -> Result<Tensor<2>, Sam2Error> {
    let mut tokens = Vec::new();
    if let Some([x0, y0, x1, y1]) = prompt.box_px {
        tokens.push(encoder.place(frame.place([x0, y0], side)?, 2));
        tokens.push(encoder.place(frame.place([x1, y1], side)?, 3));
        if x1 < x0 || y1 < y0 {
            return Err(Sam2Error::Reversed([x0, y0, x1, y1]));
        }
    }
    for point in &prompt.points {
        let at = frame.place(point.at_px, side)?;
        tokens.push(encoder.place(at, usize::from(point.on_object)));
    }
    if tokens.is_empty() {
        tokens.push(encoder.nowhere());
    }
    tokens.push(encoder.nowhere());
    Ok(Tensor::cat(tokens, 0))
}

/// The logits of a prompt's mask, `[1, 1, 4 h, 4 w]`.
///
/// # Errors
///
/// [`Sam2Error`] if it has another size than `side` or numbers that are not finite.
pub fn mask(mask: &Plane<f32>, side: usize, device: &Device) -> Result<Tensor<4>, Sam2Error> {
    if mask.size() != (side, side) {
        return Err(Sam2Error::MaskSize { width: mask.width(), height: mask.height(), expected: side });
    }
    if !mask.data().iter().all(|x| x.is_finite()) {
        return Err(Sam2Error::NotFinite);
    }
    Ok(tensor(mask.data().to_vec(), [1, 1, side, side], device))
}

/// Whether `prompt` asks for something.
///
/// # Errors
///
/// [`Sam2Error::NothingAsked`] if not.
pub fn check(prompt: &Prompt) -> Result<(), Sam2Error> {
    if prompt.points.is_empty() && prompt.box_px.is_none() && prompt.mask_logits.is_none() {
        return Err(Sam2Error::NothingAsked);
    }
    Ok(())
}

/// Columns and rows that places are counted in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    pub width: usize,
    pub height: usize,
}

impl Frame {
    /// Of `width` by `height`.
    ///
    /// # Errors
    ///
    /// [`Sam2Error::NoPixels`] if there are none.
    pub fn of(what: &'static str, (width, height): (usize, usize)) -> Result<Self, Sam2Error> {
        if width.min(height) == 0 {
            return Err(Sam2Error::NoPixels { what, width, height });
        }
        Ok(Self { width, height })
    }

    /// A place, as parts of the square's sides. Pixels have their centres at halves in both; SAM scales their numbers.
    ///
    /// # Errors
    ///
    /// [`Sam2Error::Outside`] if it is not in the image, borders included.
    pub fn place(self, at_px: [f32; 2], side: usize) -> Result<[f32; 2], Sam2Error> {
        let Self { width, height } = self;
        let [x, y] = at_px;
        if !(0.0..=width as f32).contains(&x) || !(0.0..=height as f32).contains(&y) {
            return Err(Sam2Error::Outside { at_px, width, height });
        }
        let side = side as f32;
        let part = |x: f32, n: usize| ((x - 0.5) / n as f32 * side + 0.5) / side;
        Ok([part(x, width), part(y, height)])
    }
}

/// `image` as the network takes it, `[1, 3, side, side]`: squeezed to a square, normalised.
///
/// # Errors
///
/// [`Sam2Error::NoPixels`] if it has none.
pub fn squared(image: &RgbImage, side: usize, device: &Device) -> Result<Tensor<4>, Sam2Error> {
    let (width, height) = image.size();
    let square = resize_rgb(image, side, side, ResizeFilter::Cubic).ok_or(Sam2Error::NoPixels {
        what: "an image",
        width,
        height,
    })?;
    let values = planes(&square, IMAGENET_MEAN, IMAGENET_STD);
    Ok(tensor(values, [1, 3, side, side], device))
}

/// A mask of an image as one of the square, `[side][side]`, 1 where the object is: where at least half of a pixel is it.
pub fn squared_mask(mask: &Plane<bool>, side: usize) -> Vec<f32> {
    let (w, h) = mask.size();
    let values: Vec<f32> = mask.data().iter().map(|&on| f32::from(u8::from(on))).collect();
    if (w, h) == (side, side) {
        return values;
    }
    let mut out = resampled(&values, w, h, &Kernels::triangle(w, side), &Kernels::triangle(h, side));
    for x in &mut out {
        *x = f32::from(u8::from(*x >= 0.5));
    }
    out
}

/// `plane`, which has pixels, with another number of columns and rows, bilinear and without a filter where it becomes smaller.
pub fn stretched(plane: &Plane<f32>, (width, height): (usize, usize)) -> Plane<f32> {
    let (w, h) = plane.size();
    let values = resampled(plane.data(), w, h, &Kernels::linear(w, width), &Kernels::linear(h, height));
    Plane::from_fn(width, height, |x, y| values[y * width + x])
}

/// What fills a hole: just above the border.
const FILLED: f32 = 0.1;

/// Fills the holes of a mask, above 0 where the object is, that have at most `most` pixels: what is not the object and hangs together, over
/// corners too.
pub fn fill(logits: &mut Plane<f32>, most: usize) {
    if most == 0 {
        return;
    }
    let (w, h) = logits.size();
    // what is no number is no hole
    let mut open: Vec<bool> = logits.data().iter().map(|&x| x <= 0.0).collect();
    let mut part = Vec::new();
    for start in 0..w * h {
        if !open[start] {
            continue;
        }
        open[start] = false;
        part.clear();
        part.push(start);
        let mut next = 0;
        while let Some(&at) = part.get(next) {
            next += 1;
            let (x, y) = (at % w, at / w);
            for ny in y.saturating_sub(1)..(y + 2).min(h) {
                for nx in x.saturating_sub(1)..(x + 2).min(w) {
                    if std::mem::take(&mut open[ny * w + nx]) {
                        part.push(ny * w + nx);
                    }
                }
            }
        }
        if part.len() <= most {
            for &at in &part {
                logits.data_mut()[at] = FILLED;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::fill;
    use m4_core::Plane;

    fn mask(rows: &[&str]) -> Plane<f32> {
        Plane::from_fn(rows[0].len(), rows.len(), |x, y| match rows[y].as_bytes()[x] {
            b'#' => 3.0,
            _ => -2.0,
        })
    }

    #[test]
    fn small_holes_are_filled_and_large_ones_stay() {
        let before = mask(&["#####.", "#.##..", "##.#..", "#####.", "#.#.#.", "###.#."]);
        for (most, filled) in [(0, vec![]), (1, vec![(1, 4)]), (2, vec![(1, 1), (2, 2), (1, 4), (3, 4), (3, 5)])] {
            let mut after = before.clone();
            fill(&mut after, most);
            for (y, x) in (0..6).flat_map(|y| (0..6).map(move |x| (y, x))) {
                let want = if filled.contains(&(x, y)) { 0.1 } else { before[(x, y)] };
                assert_eq!(after[(x, y)], want, "{most}: column {x}, row {y}");
            }
        }
        for (most, left) in [(7, 8), (8, 0)] {
            let mut after = before.clone();
            fill(&mut after, most);
            assert_eq!(after.data().iter().filter(|&&x| x <= 0.0).count(), left);
        }
    }

    #[test]
    fn hole_filling_keeps_nan() {
        let mut mask = Plane::filled(3, 3, f32::NAN);
        fill(&mut mask, 100);
        assert!(mask.data().iter().all(|x| x.is_nan()));
        fill(&mut Plane::filled(0, 0, 0.0), 8);
    }
}
