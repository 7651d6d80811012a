//! A frame at the size of flow or masks.

use super::super::frame_source::FrameSource;
use super::super::source::VideoError;
use crate::classical::dense::FlowImage;
use crate::resample::rgb_and_grey;
use m4_core::RgbImage;
use std::borrow::Cow;

/// Reads a frame and checks its size.
pub fn read(clip: &dyn FrameSource, frame: usize) -> Result<Cow<'_, RgbImage>, VideoError> {
    let frames = clip.frames();
    if frame >= frames {
        return Err(VideoError::Frame { frame, frames });
    }
    let image = clip
        .image(frame)
        .map_err(|reason| VideoError::Image { frame, reason })?;
    if image.size() != clip.size() {
        return Err(VideoError::ImageSize {
            frame,
            found: image.size(),
            expected: clip.size(),
        });
    }
    Ok(image)
}

/// A frame at another size, not larger than its own.
pub struct ScaledFrame {
    pub width: usize,
    pub height: usize,
    /// `[height][width][3]`
    pub rgb: Vec<[u8; 3]>,
    /// `[height][width]`: luma 0..255.
    pub grey: Vec<f32>,
}

impl ScaledFrame {
    pub fn of(clip: &dyn FrameSource, frame: usize, size: (usize, usize)) -> Result<Self, VideoError> {
        let image = read(clip, frame)?;
        Ok(Self::from_image(image.as_ref(), size))
    }

    pub fn from_image(image: &RgbImage, (width, height): (usize, usize)) -> Self {
        let (rgb, grey) = rgb_and_grey(image, width, height);
        Self {
            width,
            height,
            rgb,
            grey,
        }
    }

    pub fn flow_image(&self) -> FlowImage<'_> {
        FlowImage {
            width: self.width,
            height: self.height,
            rgb: &self.rgb,
            grey: &self.grey,
        }
    }
}
