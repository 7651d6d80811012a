//! What is asked for, checked and encoded.

use crate::NetError;
use crate::error::refuse;
use crate::ops::{IMAGENET_MEAN, IMAGENET_STD, Kernels, planes, resampled, tensor};
use crate::sam::{Prompt, PromptEncoder};
use burn_core::tensor::{Device, Tensor};
use m4_core::{Plane, ResizeFilter, RgbImage, resize_rgb};

/// Tokens `[n, 256]` of `prompt`, checked, in an image of the size `frame`: the box's corners, the
/// points, and one that is no place; two of those where there are neither.
pub fn tokens(
    encoder: &PromptEncoder,
    prompt: &Prompt,
    frame: (usize, usize),
    side: usize,
) -> Tensor<2> {
    // as parts of the square's sides; pixels have their centres at halves in both, SAM scales their
    // numbers
    let place = |[x, y]: [f32; 2]| {
        let part = |x: f32, n: usize| ((x - 0.5) / n as f32 * side as f32 + 0.5) / side as f32;
        [part(x, frame.0), part(y, frame.1)]
    };
    let mut tokens = Vec::new();
    if let Some([x0, y0, x1, y1]) = prompt.box_px {
        tokens.extend([
            encoder.place(place([x0, y0]), 2),
            encoder.place(place([x1, y1]), 3),
        ]);
    }
    tokens.extend(
        prompt
            .points
            .iter()
            .map(|point| encoder.place(place(point.at_px), usize::from(point.on_object))),
    );
    if tokens.is_empty() {
        tokens.push(encoder.nowhere());
    }
    tokens.push(encoder.nowhere());
    Tensor::cat(tokens, 0)
}

/// The logits of a mask, `[1, 1, 4 h, 4 w]`.
pub fn mask(mask: &Plane<f32>, device: &Device) -> Tensor<4> {
    tensor(
        mask.data().to_vec(),
        [1, 1, mask.height(), mask.width()],
        device,
    )
}

/// `size`, columns and rows, of `what`, which needs pixels.
pub fn with_pixels(what: &str, size: (usize, usize)) -> Result<(usize, usize), NetError> {
    let (width, height) = size;
    if width.min(height) == 0 {
        return refuse(format!("{what} has no pixels: it is {width} x {height}"));
    }
    Ok(size)
}

/// `image` as the network takes it, `[1, 3, side, side]`: squeezed to a square, normalised.
pub fn squared(image: &RgbImage, side: usize, device: &Device) -> Result<Tensor<4>, NetError> {
    with_pixels("an image", image.size())?;
    let square = resize_rgb(image, side, side, ResizeFilter::Cubic);
    let values = square
        .map(|square| planes(&square, IMAGENET_MEAN, IMAGENET_STD))
        .unwrap_or_default();
    Ok(tensor(values, [1, 3, side, side], device))
}

/// A mask of an image as one of the square, `[side][side]`, 1 where the object is: where at least
/// half of a pixel is it.
pub fn squared_mask(mask: &Plane<bool>, side: usize) -> Vec<f32> {
    let (w, h) = mask.size();
    let values: Vec<f32> = mask
        .data()
        .iter()
        .map(|&on| f32::from(u8::from(on)))
        .collect();
    if (w, h) == (side, side) {
        return values;
    }
    let mut out = resampled(
        &values,
        w,
        h,
        &Kernels::triangle(w, side),
        &Kernels::triangle(h, side),
    );
    for x in &mut out {
        *x = f32::from(u8::from(*x >= 0.5));
    }
    out
}

/// What fills a hole: just above the border.
const FILLED: f32 = 0.1;

/// Fills the holes of a mask, above 0 where the object is, that have at most `most` pixels: what is
/// not the object and hangs together, over corners too.
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
        Plane::from_fn(rows[0].len(), rows.len(), |x, y| {
            match rows[y].as_bytes()[x] {
                b'#' => 3.0,
                _ => -2.0,
            }
        })
    }

    #[test]
    fn small_holes_are_filled_and_large_ones_stay() {
        let before = mask(&["#####.", "#.##..", "##.#..", "#####.", "#.#.#.", "###.#."]);
        for (most, filled) in [
            (0, vec![]),
            (1, vec![(1, 4)]),
            (2, vec![(1, 1), (2, 2), (1, 4), (3, 4), (3, 5)]),
        ] {
            let mut after = before.clone();
            fill(&mut after, most);
            for (y, x) in (0..6).flat_map(|y| (0..6).map(move |x| (y, x))) {
                let want = if filled.contains(&(x, y)) {
                    0.1
                } else {
                    before[(x, y)]
                };
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
