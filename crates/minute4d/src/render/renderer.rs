//! Renders images of a scene on the chosen device.

use super::draw::{Painter, to_rgb, view};
use crate::Error;
use crate::device::{GpuPainter, OpenGpu};
use m4_core::{Camera, Exposure, RgbImage, Scene};
use m4_kernels::{Frame, SimdLevel};

/// Renders a scene on a GPU if there is one, else on the CPU.
pub struct SceneRenderer<'a> {
    scene: &'a Scene,
    painter: Painter<'a>,
    on_gpu: Option<GpuPainter>,
}

impl<'a> SceneRenderer<'a> {
    /// Copies the splats to the GPU, if there is one.
    ///
    /// # Errors
    ///
    /// [`Error::Gpu`] if they do not fit.
    pub fn new(scene: &'a Scene, level: SimdLevel, gpu: Option<&OpenGpu>) -> Result<Self, Error> {
        Ok(Self {
            scene,
            painter: Painter::new(scene, level),
            on_gpu: gpu.map(|gpu| gpu.painter(&scene.splats)).transpose()?,
        })
    }

    /// The CPU painter, for planning paths.
    pub fn painter(&mut self) -> &mut Painter<'a> {
        &mut self.painter
    }

    /// Renders a camera at a time (frames) as the kernels give it: without exposure, clamping or rounding.
    ///
    /// # Errors
    ///
    /// [`Error::Gpu`] if it does not fit or the device fails.
    pub fn frame(&mut self, camera: &Camera, t: f64) -> Result<Frame, Error> {
        match &mut self.on_gpu {
            Some(gpu) => gpu.frame(&view(self.scene, camera, t)),
            None => Ok(self.painter.frame(camera, t, false).clone()),
        }
    }

    /// Renders a camera at a time (frames) to eight bits per channel, with an exposure.
    ///
    /// # Errors
    ///
    /// [`Error::Gpu`] if it does not fit or the device fails.
    pub fn image(&mut self, camera: &Camera, t: f64, exposure: &Exposure) -> Result<RgbImage, Error> {
        match &mut self.on_gpu {
            Some(gpu) => Ok(to_rgb(&gpu.frame(&view(self.scene, camera, t))?, exposure)),
            None => Ok(self.painter.image(camera, t, exposure)),
        }
    }
}
