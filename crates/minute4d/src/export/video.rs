//! Exports a video along the source cameras.

use super::ExportError;
use crate::render::{Painter, source_fps};
use crate::{Error, Observer};
use m4_core::Scene;
use m4_io::scene::{Loss, Written};
use m4_io::video::Mp4Writer;
use m4_kernels::SimdLevel;
use std::path::Path;

/// Renders every camera of the source at its own moment, with its exposure, in the order of time.
pub(super) fn write(out: &Path, scene: &Scene, fps: Option<f64>, observer: &dyn Observer) -> Result<Written, Error> {
    let size = match scene.source.first() {
        Some(first) => first.camera.intrinsics,
        None => return Err(ExportError::NoCameras.into()),
    };
    let mut painter = Painter::new(scene, SimdLevel::detect()?);
    let fps = fps.unwrap_or_else(|| source_fps(scene));
    let mut writer = Mp4Writer::create(out, size.width, size.height, fps)?;
    for (i, frame) in scene.source.iter().enumerate() {
        if observer.cancelled() {
            return Err(Error::Stopped {
                stage: "export",
                saved: false,
            });
        }
        let camera = frame.camera.resized(size.width, size.height);
        writer.push(&painter.image(&camera, frame.t, &frame.exposure))?;
        observer.update("export", i + 1, scene.source.len(), "");
    }
    writer.finish()?;
    let bytes = std::fs::metadata(out)
        .map_err(|source| Error::Read {
            path: out.to_path_buf(),
            source,
        })?
        .len();
    Ok(Written {
        path: out.to_path_buf(),
        bytes,
        splats: 0,
        losses: vec![Loss::Baked(format!("everything, into {} images", scene.source.len()))],
    })
}
