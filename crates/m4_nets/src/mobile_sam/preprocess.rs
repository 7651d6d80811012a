//! Images of any size as the network takes them, and its masks in their size.

use crate::NetError;
use crate::error::refuse;
use crate::ops::{bilinear_plane, tensor};
use burn_core::tensor::{Device, Tensor};
use m4_core::{Plane, ResizeFilter, RgbImage, resize_rgb};

/// Sides of the image that the network takes, of the embedding, and of the masks.
pub const INPUT_SIDE: usize = 1024;
pub const EMBEDDING_SIDE: usize = 64;
pub const MASK_SIDE: usize = 256;
/// Mean and standard deviation of red, green and blue that the weights were trained with.
const MEAN: [f32; 3] = [123.675, 116.28, 103.53];
const STD: [f32; 3] = [58.395, 57.12, 57.375];

/// How an image lies in the square that the network takes: its longer side as long as that, in the
/// upper left.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Scale {
    width: usize,
    height: usize,
}

impl Scale {
    /// Of an image of `width` by `height`; it may not be so narrow that it would have no pixels in
    /// the square.
    pub fn of((width, height): (usize, usize)) -> Result<Self, NetError> {
        let scale = Self { width, height };
        let (w, h) = if width.min(height) == 0 {
            (0, 0)
        } else {
            scale.inside()
        };
        if w.min(h) == 0 {
            return refuse(format!(
                "masks need an image with pixels on both sides when the longer has 1024, not {width} x {height}"
            ));
        }
        Ok(scale)
    }

    /// Width and height of the image in the square.
    fn inside(self) -> (usize, usize) {
        let longer = self.width.max(self.height);
        let side = |side: usize| (2 * side * INPUT_SIDE + longer) / (2 * longer);
        (side(self.width), side(self.height))
    }

    /// A place in the image, as one in the square. Pixels have their centres at halves in both; SAM
    /// scales their numbers.
    pub fn to_input(self, [x, y]: [f32; 2]) -> [f32; 2] {
        let (width, height) = self.inside();
        let place = |x: f32, from: usize, to: usize| (x - 0.5) * (to as f32 / from as f32) + 0.5;
        [place(x, self.width, width), place(y, self.height, height)]
    }

    /// The image `[1, 3, 1024, 1024]`, normalised, zero beside it.
    pub fn tensor(self, image: &RgbImage, device: &Device) -> Result<Tensor<4>, NetError> {
        let (width, height) = self.inside();
        let image = resize_rgb(image, width, height, ResizeFilter::Triangle);
        let Some(image) = image else {
            return refuse("masks need an image with pixels");
        };
        let mut values = vec![0.0; 3 * INPUT_SIDE * INPUT_SIDE];
        for (channel, plane) in values.chunks_exact_mut(INPUT_SIDE * INPUT_SIDE).enumerate() {
            for (y, row) in plane.chunks_exact_mut(INPUT_SIDE).take(height).enumerate() {
                for (value, pixel) in row.iter_mut().zip(image.row(y)) {
                    *value = (f32::from(pixel[channel]) - MEAN[channel]) / STD[channel];
                }
            }
        }
        Ok(tensor(values, [1, 3, INPUT_SIDE, INPUT_SIDE], device))
    }

    pub fn size(self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// A mask of the image, of any size, as one of the square, `[256][256]`: bilinear, the least of
    /// its numbers beside the image.
    pub fn to_square(self, mask: &Plane<f32>) -> Plane<f32> {
        let (width, height) = self.inside();
        let beside = mask.data().iter().copied().fold(0.0, f32::min);
        let (last_x, last_y) = (
            mask.width().saturating_sub(1),
            mask.height().saturating_sub(1),
        );
        let at = |i: usize, inside: usize, n: usize| {
            let share = (i as f32 + 0.5) * (INPUT_SIDE / MASK_SIDE) as f32 / inside as f32;
            (share <= 1.0).then(|| (share * n as f32 - 0.5).max(0.0))
        };
        Plane::from_fn(MASK_SIDE, MASK_SIDE, |x, y| {
            let places = (at(x, width, mask.width()), at(y, height, mask.height()));
            let (Some(x), Some(y)) = places else {
                return beside;
            };
            let (x0, y0) = ((x as usize).min(last_x), (y as usize).min(last_y));
            let (dx, dy) = (x - x0 as f32, y - y0 as f32);
            let along =
                |y: usize| mask[(x0, y)] * (1.0 - dx) + mask[((x0 + 1).min(last_x), y)] * dx;
            along(y0) * (1.0 - dy) + along((y0 + 1).min(last_y)) * dy
        })
    }

    /// A mask of the square, `[256][256]`, as one of the image with `size` columns and rows:
    /// bilinear to the square's, without what lies beside the image, bilinear to that.
    pub fn to_image(self, mask: &Plane<f32>, size: (usize, usize)) -> Plane<f32> {
        let (width, height) = self.inside();
        let square = bilinear_plane(mask, (INPUT_SIDE, INPUT_SIDE));
        let inside = Plane::from_fn(width, height, |x, y| square[(x, y)]);
        bilinear_plane(&inside, size)
    }
}

#[cfg(test)]
mod tests {
    use super::{MASK_SIDE, Scale};
    use m4_core::Plane;

    #[test]
    fn a_mask_goes_to_the_square_and_comes_back() {
        // Straight lines survive bilinear sampling; the image takes the upper 144 rows of 256.
        let scale = Scale::of((640, 360)).unwrap();
        let mask = Plane::from_fn(320, 180, |x, y| 0.05 * x as f32 - 0.1 * y as f32 + 2.0);
        let square = scale.to_square(&mask);
        assert_eq!(square.size(), (MASK_SIDE, MASK_SIDE));
        let least = mask[(0, 179)];
        assert_eq!((square[(3, 150)], square[(255, 255)]), (least, least));
        assert!((square[(128, 72)] - (0.05 * 160.125 - 0.1 * 90.125 + 2.0)).abs() < 1e-3);
        let back = scale.to_image(&square, (320, 180));
        for (x, y) in [(5, 5), (160, 90), (300, 170), (20, 150)] {
            let (got, want) = (back[(x, y)], mask[(x, y)]);
            assert!((got - want).abs() < 1e-3, "{x}, {y}: {got} for {want}");
        }
    }
}
