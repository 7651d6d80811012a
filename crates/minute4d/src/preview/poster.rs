//! `poster.jpg`: a small image of a frame and its re-render, for overviews of many clips.

use super::{panel_size, sharpest};
use crate::folder::{CAPTURE_FOLDER, SCENE_FILE};
use crate::record::{FileRecord, RUN_FILE, RunRecord};
use crate::render::SceneRenderer;
use crate::settings::Settings;
use crate::{Error, hash, train};
use m4_core::{Plane, ResizeFilter, Silent, resize_rgb};
use m4_io::image::write_rgb;
use m4_io::scene::safetensors;
use m4_kernels::SimdLevel;
use std::fs;
use std::path::{Path, PathBuf};

/// Name of the file in the folder of a run.
pub const POSTER_FILE: &str = "poster.jpg";
/// Longest side of each of the two images, pixels: a page of a thousand posters stays under 50 MB.
const SIDE_PX: usize = 240;

/// Makes the poster of a finished run of `input` and notes it in the run's record. The frame is the one that
/// the preview freezes.
///
/// # Errors
///
/// [`Error::Missing`] where the folder holds no run; [`Error`] where scene or capture cannot be read or nothing can be
/// written.
pub fn poster(run: &Path, input: &Path, settings: &Settings) -> Result<PathBuf, Error> {
    let mut record = RunRecord::read(run)?.ok_or_else(|| Error::Missing {
        what: RUN_FILE,
        path: run.to_path_buf(),
    })?;
    // Warnings about the capture were given while the scene was made.
    let made = run.join(CAPTURE_FOLDER);
    let capture = train::read(if made.is_dir() { &made } else { input }, settings, &Silent)?;
    let scene = safetensors::read(&run.join(SCENE_FILE))?.scene;
    let frame = sharpest::sharpest(&capture).min(scene.source.len().saturating_sub(1));
    let (Some(source), Some(photo)) = (scene.source.get(frame), capture.frames.get(frame)) else {
        return Err(Error::Internal {
            what: "the scene has no source frames".to_owned(),
        });
    };
    let (width, height) = panel_size(&source.camera, SIDE_PX);
    let photo = resize_rgb(&photo.rgb, width, height, ResizeFilter::Triangle);
    let mut renderer = SceneRenderer::new(&scene, SimdLevel::detect()?, None)?;
    let again = renderer.image(&source.camera.resized(width, height), source.t, &source.exposure)?;
    let mut both = Plane::filled(2 * width, height, [0; 3]);
    for y in 0..height {
        let row = both.row_mut(y);
        if let Some(photo) = &photo {
            row[..width].copy_from_slice(photo.row(y));
        }
        row[width..].copy_from_slice(again.row(y));
    }
    let path = run.join(POSTER_FILE);
    write_rgb(&path, &both)?;
    let bytes = fs::metadata(&path).map_err(|source| Error::Read {
        path: path.clone(),
        source,
    })?;
    let file = FileRecord {
        bytes: bytes.len(),
        blake3: hash::of_path(&path)?,
    };
    record.files.insert(POSTER_FILE.to_owned(), file);
    record.write(run)?;
    Ok(path)
}
