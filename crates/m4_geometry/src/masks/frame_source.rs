//! A clip whose images come one by one.

use m4_core::RgbImage;
use std::borrow::Cow;

/// The error of an image that cannot be read.
pub type ImageError = Box<dyn std::error::Error + Send + Sync>;

/// Frames by index. They are requested when needed and not cached, so a clip may read them from disk.
///
/// Called from several threads at once; the same frame must be the same image every time.
pub trait FrameSource: Sync {
    /// How many frames there are.
    fn frames(&self) -> usize;

    /// Width and height of every frame, pixels.
    fn size(&self) -> (usize, usize);

    /// Frame `frame`, below [`Self::frames`].
    ///
    /// # Errors
    ///
    /// An image that cannot be read.
    fn image(&self, frame: usize) -> Result<Cow<'_, RgbImage>, ImageError>;
}

/// Images in memory, all of the size of the first.
#[derive(Debug, Clone, Copy)]
pub struct ImageList<'a>(pub &'a [&'a RgbImage]);

impl FrameSource for ImageList<'_> {
    fn frames(&self) -> usize {
        self.0.len()
    }

    fn size(&self) -> (usize, usize) {
        self.0.first().map_or((0, 0), |image| image.size())
    }

    fn image(&self, frame: usize) -> Result<Cow<'_, RgbImage>, ImageError> {
        match self.0.get(frame) {
            Some(image) => Ok(Cow::Borrowed(image)),
            None => Err(format!("there are {} frames", self.0.len()).into()),
        }
    }
}
