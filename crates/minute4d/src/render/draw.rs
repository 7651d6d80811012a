//! Draws scenes, on the processor or a GPU.

use crate::Error;
use crate::device::{GpuPainter, OpenGpu};
use m4_core::{Camera, Exposure, Plane, RgbImage, Scene};
use m4_kernels::{Frame, Renderer, SimdLevel, View};

/// Draws images of one scene, one after the other.
pub struct Painter<'a> {
    scene: &'a Scene,
    renderer: Renderer,
}

impl<'a> Painter<'a> {
    /// Draws `scene` on the vector instructions given.
    #[must_use]
    pub fn new(scene: &'a Scene, level: SimdLevel) -> Self {
        Self { scene, renderer: Renderer::new(level) }
    }

    /// Renders a camera at a time (frames), before exposure.
    pub fn frame(&mut self, camera: &Camera, t: f64, with_depth: bool) -> &Frame {
        let view = View { with_depth, ..view(self.scene, camera, t) };
        self.renderer.render(&self.scene.splats, &view)
    }

    /// Renders an 8-bit image with an exposure.
    pub fn image(&mut self, camera: &Camera, t: f64, exposure: &Exposure) -> RgbImage {
        to_rgb(self.frame(camera, t, false), exposure)
    }

    /// Median z-depth of a view at a time (frames), world units; `None` for an empty view.
    pub fn median_depth(&mut self, camera: &Camera, t: f64) -> Option<f64> {
        let frame = self.frame(camera, t, true);
        let depth = frame.depth.iter().zip(&frame.transmittance);
        let mut seen: Vec<f32> = depth
            .filter(|&(_, &passed)| passed < 0.5)
            .map(|(&sum, &passed)| sum / (1.0 - passed))
            .filter(|z| z.is_finite() && *z > 0.0)
            .collect();
        m4_core::median(&mut seen).map(f64::from)
    }
}

/// A view of a scene as it was trained to be seen.
#[must_use]
pub fn view(scene: &Scene, camera: &Camera, t: f64) -> View {
    View {
        camera: *camera,
        t,
        background: scene.background,
        near: scene.near,
        mip: scene.mip,
        period: (scene.time_frames.max(2) - 1) as f32,
        with_depth: false,
    }
}

/// Exposed, clamped and rounded to 8 bits per channel.
#[must_use]
pub fn to_rgb(frame: &Frame, exposure: &Exposure) -> RgbImage {
    let (m, o) = (&exposure.matrix, &exposure.offset);
    Plane::from_fn(frame.width, frame.height, |x, y| {
        let i = y * frame.width + x;
        let c = [frame.rgb[0][i], frame.rgb[1][i], frame.rgb[2][i]];
        std::array::from_fn(|r| {
            let value = m[r][0] * c[0] + m[r][1] * c[1] + m[r][2] * c[2] + o[r];
            (value.clamp(0.0, 1.0) * 255.0).round() as u8
        })
    })
}

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
