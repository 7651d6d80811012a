//! The pixels that the metrics read.

use m4_core::{Mask, Plane, RgbImage, ShapeError};

/// Why two images could not be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The number of values does not match the stated size.
    #[error("an image of {width}x{height} needs planes of {expected} values; channel {channel} has {found}")]
    Length {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Index of the channel, 0..3.
        channel: usize,
        /// `width * height`.
        expected: usize,
        /// The given value.
        found: usize,
    },
    /// Two things that must have one size do not.
    #[error(
        "{what} is {}x{} but the reference is {}x{}; render or resize to the size of the reference first",
        found.0, found.1, expected.0, expected.1
    )]
    Size {
        /// The image that differs from the reference.
        what: &'static str,
        /// Width and height of the reference.
        expected: (usize, usize),
        /// Width and height found.
        found: (usize, usize),
    },
    /// No SSIM window fits in.
    #[error("SSIM needs at least {window}x{window} pixels; the image is {width}x{height}")]
    TooSmall {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Side of the window.
        window: usize,
    },
    /// A pixel that is no number.
    #[error("pixel ({x}, {y}) of channel {channel} is {value}; only finite colours can be scored")]
    NotFinite {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
        /// Index of the channel, 0..3.
        channel: usize,
        /// The value.
        value: f32,
    },
}

pub(super) fn same_size(what: &'static str, expected: (usize, usize), found: (usize, usize)) -> Result<(), ImageError> {
    if expected == found { Ok(()) } else { Err(ImageError::Size { what, expected, found }) }
}

/// A colour image in three planes, `[height][width]` each, sRGB values in `[0, 1]`, or beyond where a protocol does not clamp.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanarImage {
    width: usize,
    height: usize,
    planes: [Vec<f32>; 3],
}

impl PlanarImage {
    /// Takes planar colours, `[3][height][width]`, and clamps them to `[0, 1]`.
    ///
    /// # Errors
    ///
    /// [`ImageError::Length`] if a plane does not hold `width * height` values,
    /// [`ImageError::NotFinite`] if a value is NaN or infinite.
    pub fn from_planes(width: usize, height: usize, planes: [&[f32]; 3]) -> Result<Self, ImageError> {
        let mut image = Self::from_planes_unclamped(width, height, planes)?;
        for value in image.planes.iter_mut().flatten() {
            *value = value.clamp(0.0, 1.0);
        }
        Ok(image)
    }

    /// The same without clamping, for protocols that score unclamped renders.
    ///
    /// # Errors
    ///
    /// As [`Self::from_planes`].
    pub fn from_planes_unclamped(width: usize, height: usize, planes: [&[f32]; 3]) -> Result<Self, ImageError> {
        for (channel, plane) in planes.iter().enumerate() {
            if ShapeError::check("plane", width * height, plane.len()).is_err() {
                let (expected, found) = (width * height, plane.len());
                return Err(ImageError::Length { width, height, channel, expected, found });
            }
            if let Some(i) = plane.iter().position(|v| !v.is_finite()) {
                return Err(ImageError::NotFinite { x: i % width, y: i / width, channel, value: plane[i] });
            }
        }
        let planes = planes.map(<[f32]>::to_vec);
        Ok(Self { width, height, planes })
    }

    /// Columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// `(width, height)`.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The three colour planes, `[height][width]` each, in `[0, 1]` unless made without clamping.
    #[must_use]
    pub fn planes(&self) -> &[Vec<f32>; 3] {
        &self.planes
    }
}

impl From<&RgbImage> for PlanarImage {
    fn from(image: &RgbImage) -> Self {
        let plane = |c: usize| image.data().iter().map(|rgb| f32::from(rgb[c]) / 255.0).collect();
        Self { width: image.width(), height: image.height(), planes: [plane(0), plane(1), plane(2)] }
    }
}

/// An image of one value, for tests.
#[cfg(test)]
pub(super) fn flat(width: usize, height: usize, value: f32) -> PlanarImage {
    let plane = vec![value; width * height];
    PlanarImage::from_planes(width, height, [&plane, &plane, &plane]).unwrap()
}

/// The mask grown by `radius_px` in every direction (a square of side `2 radius + 1`).
#[must_use]
pub fn dilated(mask: &Mask, radius_px: usize) -> Mask {
    let (width, height) = mask.size();
    let grown = m4_core::dilated(mask.data(), width, height, radius_px);
    Plane::from_fn(width, height, |x, y| grown[y * width + x])
}

#[cfg(test)]
mod tests {
    use super::dilated;
    use m4_core::Plane;

    #[test]
    fn dilation_grows_a_square() {
        let dot = Plane::from_fn(9, 9, |x, y| if (x, y) == (4, 1) { 255 } else { 0 });
        let grown = dilated(&dot, 2);
        let count = grown.data().iter().filter(|&&m| m == 255).count();
        assert_eq!(count, 5 * 4);
        assert_eq!(dilated(&dot, 0), dot);
    }
}
