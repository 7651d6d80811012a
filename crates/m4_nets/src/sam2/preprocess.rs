//! Images of any size as the network takes them, a square, and its masks in their size.

use super::Sam2Error;
use crate::ops::{IMAGENET_MEAN, IMAGENET_STD, Kernels, planes, resampled, tensor};
use burn_core::tensor::{Device, Tensor};
use m4_core::{Plane, ResizeFilter, RgbImage, resize_rgb};

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
