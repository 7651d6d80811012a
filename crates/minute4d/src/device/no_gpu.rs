//! Replaces the GPU in a build without GPU support; every request is an error.

use crate::Error;
use m4_core::Splats;
use m4_kernels::{Frame, View};
use m4_train::Backend;

/// A GPU that was started; there is none in this build.
#[derive(Debug, Clone)]
pub enum OpenGpu {}

impl OpenGpu {
    pub(super) fn best() -> Result<Option<Self>, Error> {
        Ok(None)
    }

    pub(super) fn open(_: Option<usize>) -> Result<Self, Error> {
        Err(Error::NoGpuSupport)
    }

    /// What it is called.
    #[must_use]
    pub fn name(&self) -> &str {
        match *self {}
    }

    pub(super) fn for_networks(&self) -> super::NetworkDevice {
        match *self {}
    }

    /// Draws `splats` on it.
    ///
    /// # Errors
    ///
    /// Never: there is no value of this type.
    pub fn painter(&self, _: &Splats) -> Result<GpuPainter, Error> {
        match *self {}
    }

    /// Takes training steps on it.
    #[must_use]
    pub fn training(&self, _: Option<usize>, _: usize) -> Box<dyn Backend> {
        match *self {}
    }
}

/// What draws on a GPU; there is none in this build.
#[derive(Debug)]
pub enum GpuPainter {}

impl GpuPainter {
    /// The image of `view`.
    ///
    /// # Errors
    ///
    /// Never: there is no value of this type.
    pub fn frame(&mut self, _: &View) -> Result<Frame, Error> {
        match *self {}
    }
}
