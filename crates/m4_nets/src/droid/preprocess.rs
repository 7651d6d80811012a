//! Prepares images for the encoders.

use super::DroidError;
use crate::ops::tensor;
use burn_core::tensor::{Device, Tensor};
use m4_core::RgbImage;

/// Mean and standard deviation of red, green and blue that the weights were trained with (ImageNet's).
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const STD: [f32; 3] = [0.229, 0.224, 0.225];
/// Sides are multiples of this.
const MULTIPLE: usize = 8;
/// The smallest side: correlation is pooled down to an eighth of an eighth, which must have pixels (upstream's limit, too).
const SMALLEST: usize = 128;

/// Whether the network takes images of this size.
///
/// # Errors
///
/// [`DroidError::Size`] if a side is too short or no multiple of 8.
pub fn check((width, height): (usize, usize)) -> Result<(), DroidError> {
    if [width, height].iter().any(|&side| side < SMALLEST || side % MULTIPLE != 0) {
        return Err(DroidError::Size { width, height });
    }
    Ok(())
}

/// `image` as `[1, 3, h, w]`, normalised.
///
/// # Errors
///
/// [`DroidError::Size`] if a side is too short or no multiple of 8.
pub fn normalised(image: &RgbImage, device: &Device) -> Result<Tensor<4>, DroidError> {
    let (width, height) = image.size();
    if [width, height].iter().any(|&side| side < SMALLEST || side % MULTIPLE != 0) {
        return Err(DroidError::Size { width, height });
    }
    let mut values = Vec::with_capacity(3 * width * height);
    for channel in 0..3 {
        for y in 0..height {
            let row = image.row(y).iter();
            values.extend(row.map(|p| (f32::from(p[channel]) / 255.0 - MEAN[channel]) / STD[channel]));
        }
    }
    Ok(tensor(values, [1, 3, height, width], device))
}
