//! Images of any size as the network takes them, and its disparity in their size.

use super::DisparityError;
use crate::dinov2::PATCH;
use crate::ops::{IMAGENET_MEAN, IMAGENET_STD, Kernels, planes, resampled, tensor};
use burn_core::tensor::{Device, Tensor};
use m4_core::{Plane, RgbImage};

/// Pixels that the longer side has at most.
const LONGEST: usize = 768;

/// Sides of an image and of what the network makes of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sides {
    width: usize,
    height: usize,
}

impl Sides {
    /// Of an image of `width` by `height`.
    ///
    /// # Errors
    ///
    /// [`DisparityError::Empty`] if it has no pixels.
    pub fn of(width: usize, height: usize) -> Result<Self, DisparityError> {
        if width == 0 || height == 0 {
            return Err(DisparityError::Empty);
        }
        Ok(Self { width, height })
    }

    /// Width and height that the network works with: those of the image in the same ratio with the longer at 768, rounded to whole
    /// patches (down where that would make more than 768), one patch at least.
    pub fn inside(self) -> (usize, usize) {
        let scale = LONGEST as f64 / self.width.max(self.height) as f64;
        let side = |side: usize| {
            let patches = side as f64 * scale / PATCH as f64;
            let near = patches.round_ties_even() as usize;
            let near = if near * PATCH > LONGEST { patches.floor() as usize } else { near };
            near.max(1) * PATCH
        };
        (side(self.width), side(self.height))
    }

    /// The image `[1, 3, height, width]` of the sides [`Sides::inside`], normalised.
    pub fn tensor(self, image: &RgbImage, device: &Device) -> Tensor<4> {
        let (width, height) = self.inside();
        let values = planes(image, IMAGENET_MEAN, IMAGENET_STD);
        let columns = Kernels::cubic(self.width, width);
        let rows = Kernels::cubic(self.height, height);
        let values = resampled(&values, self.width, self.height, &columns, &rows);
        tensor(values, [1, 3, height, width], device)
    }

    /// Disparity of the sides [`Sides::inside`] in those of the image.
    pub fn to_image(self, disparity: &[f32]) -> Plane<f32> {
        let (width, height) = self.inside();
        let columns = Kernels::linear(width, self.width);
        let rows = Kernels::linear(height, self.height);
        let values = resampled(disparity, width, height, &columns, &rows);
        Plane::from_fn(self.width, self.height, |x, y| values[y * self.width + x])
    }
}

#[cfg(test)]
mod tests {
    use super::Sides;

    /// The table of `fixtures/ops/size_rules`: width and height, then those inside.
    #[test]
    fn sides_are_those_of_the_reference() {
        let table = [
            (854, 480, 756, 434),
            (480, 854, 434, 756),
            (1920, 1080, 756, 434),
            (640, 480, 756, 574),
            (1024, 768, 756, 574),
            (512, 512, 756, 756),
            (360, 640, 434, 756),
            (1280, 720, 756, 434),
            (333, 777, 336, 756),
            (500, 375, 756, 574),
        ];
        for (w, h, width, height) in table {
            assert_eq!(Sides::of(w, h).unwrap().inside(), (width, height), "{w} x {h}");
        }
        assert_eq!(Sides::of(100_000, 1).unwrap().inside(), (756, 14));
        assert!(Sides::of(0, 4).is_err());
    }

    /// A constant stays one, and a slope goes to the image's size and keeps its ends.
    #[test]
    fn disparity_is_resized_to_the_image() {
        let sides = Sides::of(300, 200).unwrap();
        let (w, h) = sides.inside();
        let slope: Vec<f32> = (0..w * h).map(|i| (i % w) as f32 + 0.5).collect();
        let back = sides.to_image(&slope);
        assert_eq!(back.size(), (300, 200));
        let want = 150.5 * w as f32 / 300.0;
        assert!((back[(150, 70)] - want).abs() < 1e-3, "{} for {want}", back[(150, 70)]);
    }
}
