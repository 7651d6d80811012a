//! Methods of captures and scenes: reading, writing, drawing. `use minute4d::prelude::*` brings
//! them and the types of the first page.

pub use crate::{Options, Video, reconstruct, train};
pub use m4_core::{Camera, Capture, RgbImage, Scene};

use crate::Error;
use crate::export::{self, Format};
use crate::page::{Page, median_depth, pack};
use crate::render::Painter;
use m4_core::{Exposure, Silent, Splats};
use m4_io::capture::{CaptureOptions, Split};
use m4_io::scene::{instant, safetensors};
use m4_kernels::{SimdLevel, pose};
use std::collections::BTreeMap;
use std::path::Path;

/// Files of captures.
pub trait CaptureExt: Sized {
    /// Reads the training frames of a capture: a folder with `transforms_train.json`, or such a
    /// file (`docs/formats.md`).
    ///
    /// # Errors
    ///
    /// [`Error::ReadData`] naming the file that is missing or damaged.
    fn read(path: impl AsRef<Path>) -> Result<Self, Error>;

    /// Writes a capture into a folder, which is made if it is missing.
    ///
    /// # Errors
    ///
    /// [`Error::WriteData`].
    fn write(&self, folder: impl AsRef<Path>) -> Result<(), Error>;
}

impl CaptureExt for Capture {
    fn read(path: impl AsRef<Path>) -> Result<Self, Error> {
        Ok(m4_io::capture::read(
            path.as_ref(),
            Split::Train,
            &CaptureOptions::default(),
            &Silent,
        )?)
    }

    fn write(&self, folder: impl AsRef<Path>) -> Result<(), Error> {
        Ok(m4_io::capture::write(
            folder.as_ref(),
            self,
            Split::Train,
            &Silent,
        )?)
    }
}

/// Files and images of scenes.
pub trait SceneExt: Sized {
    /// Reads a `scene.safetensors`.
    ///
    /// # Errors
    ///
    /// [`Error::ReadData`].
    fn read(path: impl AsRef<Path>) -> Result<Self, Error>;

    /// Writes a scene as `.safetensors`, whole or not at all; an existing file is replaced.
    ///
    /// # Errors
    ///
    /// [`Error::WriteData`].
    fn write(&self, path: impl AsRef<Path>) -> Result<(), Error>;

    /// The splats that are visible at a time, frames from 0 to `time_frames - 1`; all of them
    /// static.
    fn at(&self, t: f64) -> Splats;

    /// Renders what a camera sees at a time, frames. Axes are OpenCV's, poses camera to world.
    /// [`Painter`] is faster for many images.
    ///
    /// # Errors
    ///
    /// [`Error::Simd`] if vector instructions are asked for that this processor lacks.
    fn render(&self, camera: &Camera, t: f64) -> Result<RgbImage, Error>;

    /// Writes the page that shows the scene in a browser, one file, whole or not at all; an
    /// existing file is replaced. The frames of `capture`, that of the training, are shown beside
    /// it.
    ///
    /// # Errors
    ///
    /// [`Error::Frames`] if the frames cannot be encoded, [`Error::Page`] if the page cannot be
    /// made, [`Error::Write`].
    fn write_page(
        &self,
        path: impl AsRef<Path>,
        title: &str,
        capture: &Capture,
    ) -> Result<(), Error>;

    /// Exports the scene for other tools, in the format that the ending of `path` names
    /// (`docs/formats.md`); formats of one instant get the middle of the clip. Returns what the
    /// format cannot hold.
    ///
    /// # Errors
    ///
    /// [`Error::Refused`] for an unknown ending, [`Error::Output`] if the file exists,
    /// [`Error::WriteData`] if it cannot be written.
    fn export(&self, path: impl AsRef<Path>) -> Result<export::Losses, Error>;
}

impl SceneExt for Scene {
    fn read(path: impl AsRef<Path>) -> Result<Self, Error> {
        Ok(safetensors::read(path.as_ref())?.scene)
    }

    fn write(&self, path: impl AsRef<Path>) -> Result<(), Error> {
        Ok(safetensors::write(
            path.as_ref(),
            self,
            None,
            &BTreeMap::new(),
        )?)
    }

    fn at(&self, t: f64) -> Splats {
        instant(&pose::at(&self.splats, t as f32), t, self.period_frames())
    }

    fn render(&self, camera: &Camera, t: f64) -> Result<RgbImage, Error> {
        Ok(Painter::new(self, SimdLevel::detect()?).image(camera, t, &Exposure::IDENTITY))
    }

    fn write_page(
        &self,
        path: impl AsRef<Path>,
        title: &str,
        capture: &Capture,
    ) -> Result<(), Error> {
        let depth = median_depth(self, SimdLevel::detect()?);
        Page::new(pack(self, title, depth), capture, self)?.write(path.as_ref())
    }

    fn export(&self, path: impl AsRef<Path>) -> Result<export::Losses, Error> {
        let path = path.as_ref();
        let format = Format::of_path(path).ok_or_else(|| {
            let names = Format::names();
            crate::Refusal::usage(format!(
                "the ending of {} names no format; formats are {names}",
                path.display()
            ))
        })?;
        Ok(export::scene(self, path, &export::ExportJob::new(format), &Silent)?.losses)
    }
}
