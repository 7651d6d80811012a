//! Dilation of masks, and resizing of images as Pillow does it, which networks were trained with:
//! the filter is as wide as a new pixel where images become smaller, works along rows and then
//! along columns, and is rounded to bytes after each. In whole numbers, as Pillow's, so that the
//! bytes are the same.

use crate::{Plane, RgbImage};
use rayon::prelude::*;

/// Binary digits of weights behind the point.
const DIGITS: u32 = 22;

/// How a new pixel weighs the old ones around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResizeFilter {
    /// Linear to both sides: `BILINEAR`.
    Triangle,
    /// The cubic of Keys with a = -0.5: `BICUBIC`, the default of `resize`.
    Cubic,
}

impl ResizeFilter {
    /// Pixels to each side.
    fn reach(self) -> f64 {
        match self {
            Self::Triangle => 1.0,
            Self::Cubic => 2.0,
        }
    }

    /// The weight at a distance.
    fn weight(self, x: f64) -> f64 {
        let x = x.abs();
        match self {
            Self::Triangle => (1.0 - x).max(0.0),
            Self::Cubic if x < 1.0 => (1.5 * x - 2.5) * x * x + 1.0,
            Self::Cubic if x < 2.0 => ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0,
            Self::Cubic => 0.0,
        }
    }
}

/// The pixels that a new one is made of: the first of them, and weights that sum to one.
struct Window {
    first: usize,
    weights: Vec<i32>,
}

fn windows(filter: ResizeFilter, from: usize, to: usize) -> Vec<Window> {
    let scale = from as f64 / to as f64;
    let wide = scale.max(1.0);
    let reach = filter.reach() * wide;
    let one = f64::from(1i32 << DIGITS);
    let of = |i: usize| {
        let centre = (i as f64 + 0.5) * scale;
        let first = (centre - reach + 0.5).max(0.0) as usize;
        let end = ((centre + reach + 0.5) as usize).min(from);
        let weight = |j: usize| filter.weight((j as f64 + 0.5 - centre) / wide);
        let weights: Vec<f64> = (first..end).map(weight).collect();
        let sum: f64 = weights.iter().sum();
        Window {
            first,
            weights: weights
                .iter()
                .map(|w| (w / sum * one).round() as i32)
                .collect(),
        }
    };
    (0..to).map(of).collect()
}

/// The weighted mean of pixels, rounded to bytes.
fn mixed<'a>(weights: &[i32], pixels: impl Iterator<Item = &'a [u8; 3]>) -> [u8; 3] {
    let mut sum = [1i32 << (DIGITS - 1); 3];
    for (weight, pixel) in weights.iter().zip(pixels) {
        for (sum, &value) in sum.iter_mut().zip(pixel) {
            *sum += weight * i32::from(value);
        }
    }
    sum.map(|sum| (sum >> DIGITS).clamp(0, 255) as u8)
}

/// The image at `width` x `height` pixels; `None` if a side of the one or the other is zero.
pub fn resize_rgb(
    image: &RgbImage,
    width: usize,
    height: usize,
    filter: ResizeFilter,
) -> Option<RgbImage> {
    if image.size() == (width, height) {
        return Some(image.clone());
    }
    if image.data().is_empty() || width == 0 || height == 0 {
        return None;
    }
    let narrow = along_rows(image, width, filter);
    let rows = windows(filter, image.height(), height);
    let mut out = Plane::filled(width, height, [0; 3]);
    out.data_mut()
        .par_chunks_mut(width)
        .zip(&rows)
        .for_each(|(out, window)| {
            for (x, pixel) in out.iter_mut().enumerate() {
                let above = (window.first..).map(|y| &narrow[(x, y)]);
                *pixel = mixed(&window.weights, above);
            }
        });
    Some(out)
}

fn along_rows(image: &RgbImage, width: usize, filter: ResizeFilter) -> RgbImage {
    let columns = windows(filter, image.width(), width);
    let mut out = Plane::filled(width, image.height(), [0; 3]);
    out.data_mut()
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(y, out)| {
            let row = image.row(y);
            for (pixel, window) in out.iter_mut().zip(&columns) {
                *pixel = mixed(&window.weights, row[window.first..].iter());
            }
        });
    out
}

/// Returns the greatest value within `radius` pixels, in the larger of the two directions, of each
/// pixel of a mask `[height][width]`: a dilation by a square of side `2 radius + 1`.
pub fn dilated<T: Copy + Ord>(mask: &[T], width: usize, height: usize, radius: usize) -> Vec<T> {
    let reach = |i: usize, n: usize| i.saturating_sub(radius)..(i + radius + 1).min(n);
    let mut rows = mask.to_vec();
    for (out, row) in rows.chunks_mut(width.max(1)).zip(mask.chunks(width.max(1))) {
        for (x, out) in out.iter_mut().enumerate() {
            *out = row[reach(x, width)].iter().copied().max().unwrap_or(*out);
        }
    }
    let mut out = rows.clone();
    for y in 0..height {
        for other in reach(y, height) {
            for x in 0..width {
                out[y * width + x] = out[y * width + x].max(rows[other * width + x]);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{ResizeFilter, dilated, resize_rgb};
    use crate::Plane;

    #[test]
    fn shrinking_averages_a_fine_checkerboard() {
        let board = Plane::from_fn(
            64,
            64,
            |x, y| if (x + y) % 2 == 0 { [255; 3] } else { [0; 3] },
        );
        let small = resize_rgb(&board, 16, 16, ResizeFilter::Triangle).unwrap();
        assert_eq!(small.size(), (16, 16));
        assert!(small.data().iter().flatten().all(|v| v.abs_diff(127) <= 2));
    }

    #[test]
    fn resizing_keeps_a_ramp_in_place() {
        // Corner-based coordinates: the middle of target pixel x is source coordinate 4 x + 2.
        let ramp = Plane::from_fn(256, 4, |x, _| [x as u8; 3]);
        let small = resize_rgb(&ramp, 64, 1, ResizeFilter::Triangle).unwrap();
        for x in 2..62 {
            let want = 4.0 * x as f64 + 1.5;
            assert!((f64::from(small[(x, 0)][0]) - want).abs() <= 1.0);
        }
    }

    #[test]
    fn an_image_without_pixels_has_no_other_size() {
        let image = Plane::filled(4, 4, [9; 3]);
        assert!(resize_rgb(&image, 0, 4, ResizeFilter::Triangle).is_none());
        assert!(resize_rgb(&Plane::filled(0, 0, [0; 3]), 4, 4, ResizeFilter::Triangle).is_none());
    }

    #[test]
    fn dilation_is_a_square_that_stays_inside() {
        let mut mask = vec![false; 5 * 4];
        mask[0] = true;
        mask[2 * 5 + 4] = true;
        let wide = dilated(&mask, 5, 4, 1);
        let got: Vec<usize> = (0..20).filter(|&i| wide[i]).collect();
        assert_eq!(got, [0, 1, 5, 6, 8, 9, 13, 14, 18, 19]);
        assert_eq!(dilated(&mask, 5, 4, 0), mask);
        assert_eq!(dilated::<u8>(&[], 0, 0, 3), []);
    }
}
