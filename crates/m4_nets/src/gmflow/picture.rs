//! Pictures of any size as the network takes them, and its flow in their size.

use super::{Flow, FlowError};
use crate::ops::tensor;
use burn_core::tensor::{Device, Tensor};
use m4_scene::RgbImage;

/// Sides are multiples of this: a quarter of them is cut into 8, an eighth into 2.
const MULTIPLE: usize = 32;
/// Mean and standard deviation of red, green and blue that the weights were trained with (ImageNet's).
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const STD: [f32; 3] = [0.229, 0.224, 0.225];

/// How a picture lies within the padded one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Padding {
    pub width: usize,
    pub height: usize,
}

impl Padding {
    /// Of a picture of `width` by `height`.
    ///
    /// # Errors
    ///
    /// [`FlowError::Empty`] if it has no pixels.
    pub fn of(width: usize, height: usize) -> Result<Self, FlowError> {
        if width == 0 || height == 0 {
            return Err(FlowError::Empty);
        }
        Ok(Self { width, height })
    }

    /// Width and height that the network works with.
    pub fn padded(self) -> (usize, usize) {
        let up = |side: usize| side.next_multiple_of(MULTIPLE);
        (up(self.width), up(self.height))
    }

    /// Columns left of the picture and rows above it.
    fn before(self) -> (usize, usize) {
        let (width, height) = self.padded();
        ((width - self.width) / 2, (height - self.height) / 2)
    }

    /// The picture `[1, 3, padded height, padded width]`, normalised, its edges repeated.
    pub fn tensor(self, image: &RgbImage, device: &Device) -> Tensor<4> {
        let (width, height) = self.padded();
        let (left, top) = self.before();
        let inside = |at: usize, before: usize, side: usize| at.saturating_sub(before).min(side - 1);
        let mut values = Vec::with_capacity(3 * width * height);
        for channel in 0..3 {
            for y in 0..height {
                let row = image.row(inside(y, top, self.height));
                values.extend((0..width).map(|x| {
                    let value = f32::from(row[inside(x, left, self.width)][channel]) / 255.0;
                    (value - MEAN[channel]) / STD[channel]
                }));
            }
        }
        tensor(values, [1, 3, height, width], device)
    }

    /// The flow of the picture out of that of the padded one, `[padded height, padded width, 2]`.
    ///
    /// # Errors
    ///
    /// [`FlowError::Device`] if the device fails.
    pub fn crop(self, flow: Tensor<3>) -> Result<Flow, FlowError> {
        let (left, top) = self.before();
        let values: Vec<f32> = flow
            .narrow(0, top, self.height)
            .narrow(1, left, self.width)
            .try_into_vec_as()
            .map_err(|error| FlowError::Device(error.to_string()))?;
        Ok(Flow {
            width: self.width,
            height: self.height,
            u: values.iter().copied().step_by(2).collect(),
            v: values.iter().copied().skip(1).step_by(2).collect(),
        })
    }
}
