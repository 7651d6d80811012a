//! Makes the page that shows a scene in a browser.

use crate::Error;
use crate::error::OutputError;
use crate::render::{Painter, source_fps};
use m4_core::{Capture, RgbImage, Scene};
use m4_io::atomic::AtomicFile;
use m4_kernels::SimdLevel;
use m4_viewer::page::{self, Compression, Parts, TEMPLATE};
use m4_viewer::payload::{Payload, encode};
use m4_viewer::{About, FRAME_BYTES, Frames, Manifest, encode_frames};
use std::fs;
use std::io::Write;
use std::path::Path;

/// The splats for the page, and their metadata.
pub type Packed = (Manifest, Payload);

/// Packs the splats of a scene for the page, and describes them. `median_depth`: of what the middle
/// camera sees, world units.
pub fn pack(scene: &Scene, title: &str, median_depth: f64) -> Packed {
    let payload = encode(scene, median_depth);
    let about = About {
        title,
        median_depth,
        fps: source_fps(scene),
    };
    (Manifest::new(scene, &payload, &about), payload)
}

/// Median z-depth of the view of the middle camera, world units; 1 for an empty view.
pub fn median_depth(scene: &Scene, level: SimdLevel) -> f64 {
    let middle = scene.source.get(scene.source.len() / 2);
    let depth = middle.and_then(|s| Painter::new(scene, level).median_depth(&s.camera, s.t));
    depth.unwrap_or(1.0)
}

/// The frames of a capture for the page of a scene; `None` where they are not those of its cameras.
pub fn frames(capture: &Capture, scene: &Scene) -> Result<Option<Frames>, Error> {
    if capture.frames.len() != scene.source.len() {
        return Ok(None);
    }
    let images: Vec<&RgbImage> = capture.frames.iter().map(|f| &f.rgb).collect();
    Ok(encode_frames(&images, source_fps(scene), FRAME_BYTES)?)
}

/// A page that is not written yet.
#[derive(Debug)]
pub struct Page {
    manifest: Manifest,
    payload: Payload,
    frames: Option<Frames>,
    html: Vec<u8>,
}

impl Page {
    /// Adds the frames of the capture to the splats, and compresses all.
    pub fn new(
        (mut manifest, payload): Packed,
        capture: &Capture,
        scene: &Scene,
    ) -> Result<Self, Error> {
        let frames = frames(capture, scene)?;
        manifest.frames = frames.as_ref().map(|f| f.index.clone());
        let parts = Parts {
            manifest: &manifest,
            payload: Some(&payload.bytes),
            frames: frames.as_ref(),
        };
        let html = page::compose(TEMPLATE, &parts, Compression::default())?;
        Ok(Self {
            manifest,
            payload,
            frames,
            html,
        })
    }

    /// Writes the page, reads it back and compares.
    pub fn write(self, path: &Path) -> Result<(), Error> {
        let failed = Error::write(path);
        let mut file = AtomicFile::create(path).map_err(failed)?;
        file.write_all(&self.html).map_err(failed)?;
        drop(self.html);
        file.sync().map_err(failed)?;
        let text = fs::read_to_string(file.temporary_path()).map_err(Error::read(path))?;
        let back = page::read(&text)?;
        let same = back.manifest == self.manifest
            && back.payload.as_ref() == Some(&self.payload.bytes)
            && back.frames == self.frames;
        if !same {
            let what = "the scene in it differs".to_owned();
            return Err(OutputError::Verify {
                path: path.to_path_buf(),
                what,
            }
            .into());
        }
        file.commit().map_err(failed)
    }
}
