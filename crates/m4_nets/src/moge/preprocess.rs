//! Images of any size as the network takes them, the places of its maps' pixels, and its maps in the images' size.

use super::MoGeError;
use crate::dinov2::PATCH;
use crate::ops::{Kernels, planes, resampled, tensor};
use burn_core::tensor::{DType, Device, Tensor, TensorData};
use m4_core::RgbImage;

/// The most patches that an image may be cut into; the published networks were trained with up to 3600.
pub const MOST_TOKENS: usize = 20_000;

/// An image's sides, and the patches that it is cut into.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    pub width: usize,
    pub height: usize,
    /// Patches across and down.
    pub across: usize,
    pub down: usize,
}

impl Grid {
    /// Of an image of `width` by `height` in about `tokens` patches, one at least each way.
    ///
    /// # Errors
    ///
    /// [`MoGeError::Empty`] if it has no pixels, [`MoGeError::Tokens`] if there are to be no patches or too many.
    pub fn of(width: usize, height: usize, tokens: usize) -> Result<Self, MoGeError> {
        if width == 0 || height == 0 {
            return Err(MoGeError::Empty);
        }
        if !(1..=MOST_TOKENS).contains(&tokens) {
            return Err(MoGeError::Tokens(tokens));
        }
        let aspect = width as f64 / height as f64;
        let side = |squared: f64| (squared.sqrt().round_ties_even() as usize).clamp(1, tokens);
        Ok(Self { width, height, across: side(tokens as f64 * aspect), down: side(tokens as f64 / aspect) })
    }

    /// The image `[1, 3, 14 down, 14 across]` from 0 to 1.
    pub fn tensor(self, image: &RgbImage, device: &Device) -> Tensor<4> {
        let (width, height) = (self.across * PATCH, self.down * PATCH);
        let values = planes(image, [0.0; 3], [1.0; 3]);
        let columns = Kernels::triangle(self.width, width);
        let rows = Kernels::triangle(self.height, height);
        let values = resampled(&values, self.width, self.height, &columns, &rows);
        tensor(values, [1, 3, height, width], device)
    }

    /// Where the pixels of level `level` (of `2^level` times as many as there are patches each way) are, `[1, 2, h, w]`: to the right and
    /// down from the image's middle, in units of half its diagonal.
    pub fn places(self, level: usize, device: &Device, dtype: DType) -> Tensor<4> {
        let (w, h) = (self.across << level, self.down << level);
        let diagonal = (self.width as f64).hypot(self.height as f64);
        let place = |i: usize, n: usize, side: usize| {
            let from_middle = (2.0 * i as f64 + 1.0 - n as f64) / n as f64;
            (from_middle * side as f64 / diagonal) as f32
        };
        let x = (0..h * w).map(|i| place(i % w, w, self.width));
        let y = (0..h * w).map(|i| place(i / w, h, self.height));
        let values: Vec<f32> = x.chain(y).collect();
        Tensor::from_data(TensorData::new(values, [1, 2, h, w]), (device, dtype))
    }

    /// Planes `[n][h][w]` of a map in the image's size, bilinear.
    pub fn to_image(self, planes: &[f32], w: usize, h: usize) -> Vec<f32> {
        resampled(planes, w, h, &Kernels::linear(w, self.width), &Kernels::linear(h, self.height))
    }
}

#[cfg(test)]
mod tests {
    use super::{Grid, MOST_TOKENS};
    use crate::cpu;
    use burn_core::tensor::DType;

    #[test]
    fn patches_have_the_aspect_of_the_image() {
        let grid = |w, h, tokens| {
            let grid = Grid::of(w, h, tokens).unwrap();
            (grid.across, grid.down)
        };
        assert_eq!(grid(854, 480, 1800), (57, 32));
        assert_eq!(grid(180, 140, 80), (10, 8));
        assert_eq!(grid(1_000_000, 1, 1200), (1200, 1));
        assert_eq!(grid(1, 1, 1), (1, 1));
        assert!(Grid::of(5, 0, 1200).is_err());
        assert!(Grid::of(5, 5, 0).is_err() && Grid::of(5, 5, MOST_TOKENS + 1).is_err());
    }

    #[test]
    fn places_are_symmetric_and_end_within_the_image() {
        let grid = Grid::of(300, 400, 12).unwrap();
        let places: Vec<f32> = grid.places(1, &cpu(), DType::F32).try_into_vec_as().unwrap();
        let (w, h) = (2 * grid.across, 2 * grid.down);
        assert_eq!((w, h, places.len()), (6, 8, 96));
        // half a pixel of 300 / 6 from the left edge, which is 300 / 500 from the middle
        assert!((places[0] + 0.6 * 5.0 / 6.0).abs() < 1e-6 && (places[5] - 0.5).abs() < 1e-6);
        assert!((places[48] + 0.8 * 7.0 / 8.0).abs() < 1e-6, "{}", places[48]);
    }
}
