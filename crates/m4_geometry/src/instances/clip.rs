//! A clip whose images come one by one.

use m4_core::RgbImage;
use std::borrow::Cow;

/// Why an image could not be had.
pub type ImageError = Box<dyn std::error::Error + Send + Sync>;

/// Frames by index. They are asked for as they are needed and not kept, so a clip may read them from disk.
///
/// Called from several threads at once; the same frame must be the same image every time.
pub trait Clip: Sync {
    /// How many frames there are.
    fn frames(&self) -> usize;

    /// Width and height of every frame, pixels.
    fn size(&self) -> (usize, usize);

    /// Frame `frame`, below [`Self::frames`].
    ///
    /// # Errors
    ///
    /// Whatever keeps the image from being read.
    fn image(&self, frame: usize) -> Result<Cow<'_, RgbImage>, ImageError>;
}

/// Images in memory, all of the size of the first.
#[derive(Debug, Clone, Copy)]
pub struct ImageClip<'a>(pub &'a [&'a RgbImage]);

impl Clip for ImageClip<'_> {
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
