//! Prepares images for the networks.

use super::LpipsError;
use crate::ops::{planes, tensor};
use burn_core::tensor::{Device, Tensor};
use m4_core::{Mask, RgbImage};

/// What upstream's scaling layer takes off red, green and blue from -1 to 1, and divides them by.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// An image of sRGB values from 0 to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct LpipsImage {
    width: usize,
    height: usize,
    /// `[3][height][width]`.
    values: Vec<f32>,
}

pub(super) fn same_size(what: &'static str, expected: (usize, usize), found: (usize, usize)) -> Result<(), LpipsError> {
    if expected == found { Ok(()) } else { Err(LpipsError::Size { what, expected, found }) }
}

impl LpipsImage {
    /// Of planes of red, green and blue, `[3][height][width]`. Values beyond 0 to 1 are kept.
    ///
    /// # Errors
    ///
    /// [`LpipsError::Length`] if a plane does not hold `width * height` values, [`LpipsError::NotFinite`] if one is NaN or infinite.
    pub fn from_planes(width: usize, height: usize, planes: [&[f32]; 3]) -> Result<Self, LpipsError> {
        for (channel, plane) in planes.iter().enumerate() {
            if width.checked_mul(height) != Some(plane.len()) {
                let found = plane.len();
                return Err(LpipsError::Length { width, height, channel, found });
            }
            if let Some(i) = plane.iter().position(|v| !v.is_finite()) {
                let (x, y, value) = (i % width, i / width, plane[i]);
                return Err(LpipsError::NotFinite { x, y, channel, value });
            }
        }
        let values = planes.concat();
        Ok(Self { width, height, values })
    }

    /// `(width, height)`.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Black where `mask`, which is as large, is 0.
    pub(super) fn inside(&self, mask: &Mask) -> Self {
        let mask = mask.data().iter().cycle();
        let values = self.values.iter().zip(mask);
        Self { values: values.map(|(&v, &m)| if m == 0 { 0.0 } else { v }).collect(), ..*self }
    }

    /// `[1, 3, h, w]` after the scaling layer.
    pub(super) fn tensor(&self, device: &Device) -> Tensor<4> {
        let pixels = self.width * self.height;
        let scaled = |(i, &v): (usize, &f32)| (2.0 * v - 1.0 - SHIFT[i / pixels]) / SCALE[i / pixels];
        let values = self.values.iter().enumerate().map(scaled).collect();
        tensor(values, [1, 3, self.height, self.width], device)
    }
}

impl From<&RgbImage> for LpipsImage {
    fn from(image: &RgbImage) -> Self {
        Self { width: image.width(), height: image.height(), values: planes(image, [0.0; 3], [1.0; 3]) }
    }
}
