//! A scene, and the views that it is scored by.

use crate::error::Error;
use crate::poses::{self, Alignment};
use crate::protocol::Protocol;
use crate::truth::no_test_list;
use m4_core::{Camera, Capture, CaptureFrame, Exposure, RgbImage, Scene};
use m4_io::capture::{CaptureOptions, Split};
use m4_io::reach::Reach;
use m4_io::scene::safetensors;
use minute4d::Observer;
use minute4d::device::DeviceChoice;
use minute4d::layout::{self, SCENE_FILE};
use minute4d::render::SceneRenderer;
use minute4d::settings::Settings;
use std::path::{Path, PathBuf};

/// Options of scoring.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EvalOptions {
    /// Masks of dynamic regions are grown by this many pixels first.
    pub grow_mask: usize,
    /// Where views are drawn and LPIPS is computed.
    pub device: DeviceChoice,
    /// The protocol; `None` for joint PSNR and SSIM of what the capture holds out, in 8 bits.
    pub protocol: Option<Protocol>,
    /// Masks of co-visibility, for protocols that have some; `None` for those of the capture, or
    /// made ones.
    pub covisible: Option<PathBuf>,
    /// Refine the poses of test images as the protocol's peers do.
    pub refine_poses: bool,
    /// Which files the capture may name.
    pub reach: Reach,
}

/// A scene and the views that it is judged by.
#[derive(Debug)]
pub struct HeldOut {
    /// The file of the scene.
    pub(crate) path: PathBuf,
    /// The scene.
    pub scene: Scene,
    /// The held-out views.
    pub test: Capture,
    /// Alignment of the held-out cameras, if the scene has a world of its own.
    pub(crate) alignment: Option<Alignment>,
    stretch: f64,
}

impl HeldOut {
    /// The scene of the run `out` and the held-out views of the capture `data`, which may name
    /// files within `reach`. Refused without held-out views.
    pub fn read(
        out: &Path,
        data: &Path,
        reach: Reach,
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        layout::settle(out)?;
        let path = out.join(SCENE_FILE);
        let scene = safetensors::read(&path)?.scene;
        let options = CaptureOptions {
            reach,
            ..Settings::fast().capture
        };
        minute4d::Error::unless_exists("capture", data)?;
        if data.is_dir() && !data.join(Split::Test.file_name()).is_file() {
            return Err(no_test_list(data).into());
        }
        let test = m4_io::capture::read(data, Split::Test, &options, observer)?;
        let alignment = poses::between(&scene, data, observer)?;
        let stretch = scene.period_frames() / (test.time_frames.max(2) - 1) as f64;
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

    /// The scene as a view's camera sees it.
    pub fn draw(
        &self,
        renderer: &mut SceneRenderer<'_>,
        frame: &CaptureFrame,
    ) -> Result<RgbImage, Error> {
        Ok(renderer.image(&self.camera(frame), self.moment(frame), &Exposure::IDENTITY)?)
    }

    /// A view's camera in the world of the scene.
    pub fn camera(&self, frame: &CaptureFrame) -> Camera {
        self.alignment.as_ref().map_or(frame.camera, |a| Camera {
            c2w: a.similarity().transform_pose(&frame.camera.c2w),
            ..frame.camera
        })
    }
}
