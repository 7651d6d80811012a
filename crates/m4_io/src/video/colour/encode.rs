//! Converts sRGB to the planes of an encoder.

use super::YuvMatrix;
use m4_core::RgbImage;
use rayon::prelude::*;

/// Planes of an image in 4:2:0.
#[derive(Debug, Clone, PartialEq)]
pub struct Planes420 {
    /// Even.
    pub width: usize,
    /// Even.
    pub height: usize,
    /// `[height][width]`
    pub luma: Vec<u8>,
    /// `[height / 2][width / 2]`, blue and red.
    pub chroma: [Vec<u8>; 2],
}

impl Planes420 {
    /// Converts an image; odd sides grow by repeating the last column or row. Chroma is sited at the
    /// left luma column, between two rows, and weighed 1 2 1 along the row.
    pub fn new(image: &RgbImage, matrix: &YuvMatrix) -> Self {
        let (w, h) = image.size();
        let (width, height) = (w.next_multiple_of(2), h.next_multiple_of(2));
        let pixel = |x: usize, y: usize| image[(x.min(w - 1), y.min(h - 1))].map(f32::from);
        let mut luma = vec![0; width * height];
        luma.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, value) in row.iter_mut().enumerate() {
                *value = matrix.yuv(pixel(x, y))[0].round() as u8;
            }
        });
        let mut both = vec![[0; 2]; width / 2 * (height / 2)];
        both.par_chunks_mut(width / 2).enumerate().for_each(|(y, row)| {
            for (x, value) in row.iter_mut().enumerate() {
                let mut mean = [0.0; 3];
                for (column, weight) in [((2 * x).saturating_sub(1), 0.125), (2 * x, 0.25), (2 * x + 1, 0.125)] {
                    for line in [2 * y, 2 * y + 1] {
                        let p = pixel(column, line);
                        (0..3).for_each(|c| mean[c] += weight * p[c]);
                    }
                }
                let [_, cb, cr] = matrix.yuv(mean);
                *value = [cb.round() as u8, cr.round() as u8];
            }
        });
        let chroma = [0, 1].map(|c| both.iter().map(|v| v[c]).collect());
        Self {
            width,
            height,
            luma,
            chroma,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Planes420;
    use crate::video::colour::{Range, YuvMatrix};
    use m4_core::Plane;

    #[test]
    fn smooth_images_survive_420_round_trip() {
        let matrix = YuvMatrix::from_code(1, 480, Range::Limited).unwrap();
        let image = Plane::from_fn(41, 27, |x, y| {
            [(x * 6) as u8, (y * 9) as u8, 200 - (x * 2 + y * 3) as u8]
        });
        let planes = Planes420::new(&image, &matrix);
        assert_eq!((planes.width, planes.height), (42, 28));
        let [cb, cr] = &planes.chroma;
        let back = matrix.image_420((42, 28), [&planes.luma, cb, cr], [42, 21]).unwrap();
        for y in 0..27 {
            for x in 0..39 {
                let off = back[(x, y)].iter().zip(image[(x, y)]).map(|(a, b)| a.abs_diff(b)).max();
                assert!(off <= Some(6), "({x}, {y}): {:?} {:?}", back[(x, y)], image[(x, y)]);
            }
        }
    }
}
