//! Pictures of any size as the network takes them, and its masks in their size.

use super::SamError;
use super::resize::resized;
use crate::ops::tensor;
use burn_core::tensor::{Device, Tensor};
use m4_scene::{Plane, RgbImage};

/// Sides of the picture that the network takes, of the embedding, and of the masks.
pub const INPUT_SIDE: usize = 1024;
pub const EMBEDDING_SIDE: usize = 64;
pub const MASK_SIDE: usize = 256;
/// Mean and standard deviation of red, green and blue that the weights were trained with.
const MEAN: [f32; 3] = [123.675, 116.28, 103.53];
const STD: [f32; 3] = [58.395, 57.12, 57.375];

/// How a picture lies in the square that the network takes: its longer side as long as that, in the upper left.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Scale {
    width: usize,
    height: usize,
}

impl Scale {
    /// Of a picture of `width` by `height`.
    ///
    /// # Errors
    ///
    /// [`SamError::Shape`] if it has no pixels, or is so narrow that it would have none in the square.
    pub fn of(width: usize, height: usize) -> Result<Self, SamError> {
        let scale = Self { width, height };
        let (w, h) = if width.min(height) == 0 { (0, 0) } else { scale.inside() };
        if w.min(h) == 0 {
            return Err(SamError::Shape { width, height });
        }
        Ok(scale)
    }

    /// Width and height of the picture in the square.
    fn inside(self) -> (usize, usize) {
        let longer = self.width.max(self.height);
        let side = |side: usize| (2 * side * INPUT_SIDE + longer) / (2 * longer);
        (side(self.width), side(self.height))
    }

    /// Whether a place is in the picture, its borders included.
    ///
    /// # Errors
    ///
    /// [`SamError::Outside`] if it is not.
    pub fn check(self, at_px: [f32; 2]) -> Result<(), SamError> {
        let [x, y] = at_px;
        let Self { width, height } = self;
        if (0.0..=width as f32).contains(&x) && (0.0..=height as f32).contains(&y) {
            Ok(())
        } else {
            Err(SamError::Outside { at_px, width, height })
        }
    }

    /// A place in the picture, as one in the square. Pixels have their centres at halves in both; SAM scales their numbers.
    pub fn to_input(self, [x, y]: [f32; 2]) -> [f32; 2] {
        let (width, height) = self.inside();
        let place = |x: f32, from: usize, to: usize| (x - 0.5) * (to as f32 / from as f32) + 0.5;
        [place(x, self.width, width), place(y, self.height, height)]
    }

    /// The picture `[1, 3, 1024, 1024]`, normalised, zero beside it.
    pub fn tensor(self, image: &RgbImage, device: &Device) -> Tensor<4> {
        let (width, height) = self.inside();
        let image = resized(image, width, height);
        let mut values = vec![0.0; 3 * INPUT_SIDE * INPUT_SIDE];
        for (channel, plane) in values.chunks_exact_mut(INPUT_SIDE * INPUT_SIDE).enumerate() {
            for (y, row) in plane.chunks_exact_mut(INPUT_SIDE).take(height).enumerate() {
                for (value, pixel) in row.iter_mut().zip(image.row(y)) {
                    *value = (f32::from(pixel[channel]) - MEAN[channel]) / STD[channel];
                }
            }
        }
        tensor(values, [1, 3, INPUT_SIDE, INPUT_SIDE], device)
    }

    /// A mask of the square, `[256][256]`, at the picture's size: bilinear to the square's, without what lies beside the picture,
    /// bilinear to the picture's.
    pub fn to_picture(self, mask: &Plane<f32>) -> Plane<f32> {
        let (width, height) = self.inside();
        let square = bilinear(mask, (INPUT_SIDE, INPUT_SIDE));
        let inside = Plane::from_fn(width, height, |x, y| square[(x, y)]);
        bilinear(&inside, (self.width, self.height))
    }
}

/// `plane` with `size` columns and rows, without a filter where it becomes smaller; the borders are repeated.
fn bilinear(plane: &Plane<f32>, (width, height): (usize, usize)) -> Plane<f32> {
    let columns = taps(plane.width(), width);
    let rows = taps(plane.height(), height);
    Plane::from_fn(width, height, |x, y| {
        let (x0, x1, dx) = columns[x];
        let (y0, y1, dy) = rows[y];
        let along = |y: usize| plane[(x0, y)] * (1.0 - dx) + plane[(x1, y)] * dx;
        along(y0) * (1.0 - dy) + along(y1) * dy
    })
}

/// For each of `to` pixels the two of `from` that it lies between, and the weight of the second.
fn taps(from: usize, to: usize) -> Vec<(usize, usize, f32)> {
    let of = |i: usize| {
        let at = ((i as f64 + 0.5) * from as f64 / to as f64 - 0.5).max(0.0);
        let first = (at as usize).min(from - 1);
        (first, (first + 1).min(from - 1), (at - first as f64) as f32)
    };
    (0..to).map(of).collect()
}
