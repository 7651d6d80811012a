//! From a video to a capture, and from a capture to a scene.

use crate::cache::Steps;
use crate::geometry::{self, Plan, Reconstruction};
use crate::train::{self, Forget, Training};
use crate::{Error, Options};
use m4_core::{Capture, Scene};
use m4_kernels::SimdLevel;
use std::path::{Path, PathBuf};

/// A video file, or a folder of images in the order of their names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Video {
    path: PathBuf,
}

impl Video {
    /// Names a video; it is decoded by [`reconstruct`].
    ///
    /// # Errors
    ///
    /// [`Error::Missing`] if there is nothing at `path`.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, Error> {
        let path = path.as_ref().to_path_buf();
        Error::unless_exists("video or folder of images", &path)?;
        Ok(Self { path })
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Recovers cameras, focal length, depth, masks and tracks of a video. [`Reconstruction::summary`]
/// says how far they can be trusted.
///
/// # Errors
///
/// [`Error`]: the video cannot be read, nothing can be reconstructed, weights that were asked for are missing, or `options` stopped it.
pub fn reconstruct(video: &Video, options: &Options<'_>) -> Result<Reconstruction, Error> {
    options.settings().check()?;
    let plan = Plan::new(options.settings(), options.device_choice())?;
    geometry::compute(video.path(), &plan, Steps::new(options, None))
}

/// Trains a scene on a capture.
///
/// # Errors
///
/// [`Error`]: the capture cannot be used, training diverges, or `options` stopped it.
pub fn train(capture: &Capture, options: &Options<'_>) -> Result<Scene, Error> {
    options.settings().check()?;
    let mut training = Training {
        settings: options.settings(),
        level: SimdLevel::detect()?,
        gpu: options
            .device_choice()
            .open(|why| m4_core::Progress::warn(options, why))?,
        max_vram_mb: None,
        end: None,
    };
    train::compute(capture, &mut training, &mut Forget, options)
}
