//! A finished scene, and the held-out views of a capture placed in its world.

use super::EvaluationError;
use super::align::{self, Alignment};
use crate::device::OpenGpu;
use crate::folder::SCENE_FILE;
use crate::render::SceneRenderer;
use crate::settings::Settings;
use crate::{Error, Observer};
use m4_core::{Camera, Capture, CaptureFrame, Exposure, RgbImage, Scene};
use m4_io::capture::{CaptureOptions, Split};
use m4_io::reach::Reach;
use m4_io::scene::safetensors;
use m4_kernels::SimdLevel;
use std::path::{Path, PathBuf};

/// A scene and the views that it is judged by.
pub struct HeldOut {
    /// The file of the scene.
    pub path: PathBuf,
    /// The scene.
    pub scene: Scene,
    /// The views.
    pub test: Capture,
    /// Alignment of the held-out cameras, if the scene has a world of its own.
    pub alignment: Option<Alignment>,
    stretch: f64,
}

impl HeldOut {
    /// The scene of the run `out` and the held-out views of the capture `data`, which may name files within `reach`.
    ///
    /// # Errors
    ///
    /// [`EvaluationError::NoTestList`] without held-out views; else what could not be read.
    pub fn read(out: &Path, data: &Path, reach: Reach, observer: &dyn Observer) -> Result<Self, Error> {
        let path = out.join(SCENE_FILE);
        let scene = safetensors::read(&path)?.scene;
        let options = CaptureOptions {
            reach,
            ..Settings::fast().capture
        };
        let test = test_views(data, &options, observer)?;
        let alignment = align::between(&scene, data, observer)?;
        let stretch = (scene.time_frames.max(2) - 1) as f64 / (test.time_frames.max(2) - 1) as f64;
        Ok(Self {
            path,
            scene,
            test,
            alignment,
            stretch,
        })
    }

    /// When a view was taken, frames of the scene.
    pub fn moment(&self, frame: &CaptureFrame) -> f64 {
        frame.t * self.stretch
    }

    /// Creates a renderer of the scene.
    ///
    /// # Errors
    ///
    /// [`Error::Gpu`] if it does not fit.
    pub fn renderer(&self, level: SimdLevel, gpu: Option<&OpenGpu>) -> Result<SceneRenderer<'_>, Error> {
        SceneRenderer::new(&self.scene, level, gpu)
    }

    /// The scene as a view's camera sees it.
    ///
    /// # Errors
    ///
    /// [`Error::Gpu`] if the device fails.
    pub fn draw(&self, renderer: &mut SceneRenderer<'_>, frame: &CaptureFrame) -> Result<RgbImage, Error> {
        renderer.image(&self.camera(frame), self.moment(frame), &Exposure::IDENTITY)
    }

    /// A view's camera in the world of the scene.
    pub fn camera(&self, frame: &CaptureFrame) -> Camera {
        self.alignment.as_ref().map_or(frame.camera, |a| Camera {
            c2w: a.similarity().transform_pose(&frame.camera.c2w),
            ..frame.camera
        })
    }
}

fn test_views(data: &Path, options: &CaptureOptions, observer: &dyn Observer) -> Result<Capture, Error> {
    if !data.exists() {
        return Err(Error::Missing {
            what: "capture",
            path: data.to_path_buf(),
        });
    }
    if data.is_dir() && !data.join(Split::Test.file_name()).is_file() {
        return Err(EvaluationError::NoTestList {
            path: data.to_path_buf(),
        }
        .into());
    }
    Ok(m4_io::capture::read(data, Split::Test, options, observer)?)
}
