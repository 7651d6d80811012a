//! Images of any size as networks for flow take them, and their flow in the images' size.

use crate::FlowError;
use crate::ops::tensor;
use burn_core::tensor::{Device, Tensor};
use m4_core::{Flow, RgbImage};

/// How an image lies within the padded one: in the middle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Padding {
    pub width: usize,
    pub height: usize,
    /// Width and height that the network works with.
    pub padded: (usize, usize),
}

impl Padding {
    /// Of an image of `width` by `height`: the next sides that are multiples of `multiple` and no less than `least`, itself such
    /// a multiple.
    ///
    /// # Errors
    ///
    /// [`FlowError::Empty`] if it has no pixels.
    pub fn of(width: usize, height: usize, multiple: usize, least: usize) -> Result<Self, FlowError> {
        if width == 0 || height == 0 {
            return Err(FlowError::Empty);
        }
        let up = |side: usize| side.next_multiple_of(multiple).max(least);
        Ok(Self { width, height, padded: (up(width), up(height)) })
    }

    /// Columns left of the image and rows above it.
    fn before(self) -> (usize, usize) {
        let (width, height) = self.padded;
        ((width - self.width) / 2, (height - self.height) / 2)
    }

    /// The image `[1, 3, padded height, padded width]`, its edges repeated; `normalised` makes of a value between 0 and 1 and the
    /// number of its channel what the network takes.
    pub fn tensor(self, image: &RgbImage, normalised: impl Fn(f32, usize) -> f32, device: &Device) -> Tensor<4> {
        let (width, height) = self.padded;
        let (left, top) = self.before();
        let inside = |at: usize, before: usize, side: usize| at.saturating_sub(before).min(side - 1);
        let mut values = Vec::with_capacity(3 * width * height);
        for channel in 0..3 {
            for y in 0..height {
                let row = image.row(inside(y, top, self.height));
                values.extend((0..width).map(|x| {
                    let value = f32::from(row[inside(x, left, self.width)][channel]) / 255.0;
                    normalised(value, channel)
                }));
            }
        }
        tensor(values, [1, 3, height, width], device)
    }

    /// The flow of the image out of that of the padded one, `[padded height, padded width, 2]`.
    ///
    /// # Errors
    ///
    /// [`FlowError::Device`] if the device fails.
    pub fn crop(self, flow: Tensor<3>) -> Result<Flow, FlowError> {
        let (left, top) = self.before();
        read(flow.narrow(0, top, self.height).narrow(1, left, self.width))
    }
}

/// Flow `[height, width, 2]` off the device.
///
/// # Errors
///
/// [`FlowError::Device`] if the device fails.
pub fn read(flow: Tensor<3>) -> Result<Flow, FlowError> {
    let [height, width, _] = flow.dims();
    let values: Vec<f32> = flow.try_into_vec_as().map_err(|error| FlowError::Device(error.to_string()))?;
    Ok(Flow {
        width,
        height,
        u: values.iter().copied().step_by(2).collect(),
        v: values.iter().copied().skip(1).step_by(2).collect(),
    })
}
