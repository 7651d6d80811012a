//! A scene against the held-out views of a capture.

use super::align::Alignment;
use super::held_out::HeldOut;
use crate::device::DeviceChoice;
use crate::folder::EVAL_FILE;
use crate::record::write_json;
use crate::{Error, Observer, hash};
use m4_eval::image::{ImageReport, MeanScore, Picture};
use m4_kernels::SimdLevel;
use m4_scene::CompactMask;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// `eval.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EvalReport {
    /// Release of the program that wrote it.
    pub minute4d: String,
    /// The scene that was judged.
    pub scene: PathBuf,
    /// BLAKE3 of its file.
    pub scene_blake3: String,
    /// The capture whose held-out views were used.
    pub data: PathBuf,
    /// How the held-out cameras were placed, where the scene has a world of its own.
    pub alignment: Option<Alignment>,
    /// Splats of the scene.
    pub splats: usize,
    /// Means over all views.
    pub mean: Option<MeanScore>,
    /// Protocol, and one row a view.
    pub images: ImageReport,
    /// Seconds it took.
    pub seconds: f64,
}

/// Renders, on `device`, the held-out views of the capture `data` and compares them with its pictures; writes
/// `eval.json` into the run `out`.
///
/// Masks of moving parts are grown by `grow_mask` pixels first. A scene that was trained on another
/// capture of the same video has a world of its own; the held-out cameras are then placed by the
/// similarity that takes the training cameras of `data` to those of the scene, and a warning says how
/// well that fits.
///
/// # Errors
///
/// [`Error::NoTestList`] without held-out views; else what could not be read, compared or written.
pub fn views(
    out: &Path,
    data: &Path,
    grow_mask: usize,
    device: DeviceChoice,
    observer: &dyn Observer,
) -> Result<EvalReport, Error> {
    let start = Instant::now();
    let level = SimdLevel::detect()?;
    let held = HeldOut::read(out, data, observer)?;
    let views = &held.test.frames;
    let mut images = ImageReport::new(data.display().to_string(), grow_mask);
    let gpu = device.open()?;
    let mut pictures = held.pictures(level, gpu.as_ref())?;
    for (i, frame) in views.iter().enumerate() {
        if observer.cancelled() {
            return Err(Error::Stopped {
                stage: "eval",
                saved: false,
            });
        }
        let t = held.moment(frame);
        let drawn = held.draw(&mut pictures, frame)?;
        let (image, reference) = (Picture::from(&drawn), Picture::from(&frame.rgb));
        let index = frame.camera_index;
        let mask = frame.mask.as_ref().map(CompactMask::to_mask);
        let score = images.add(&frame.name, t, index, &image, &reference, mask.as_ref())?;
        let note = format!("{:.2} dB", score.psnr_db);
        observer.update("eval", i + 1, views.len(), &note);
    }
    let report = EvalReport {
        minute4d: env!("CARGO_PKG_VERSION").to_owned(),
        scene_blake3: hash::of_path(&held.path)?,
        data: data.to_path_buf(),
        splats: held.scene.splats.n(),
        mean: images.mean(),
        images,
        scene: held.path,
        alignment: held.alignment,
        seconds: start.elapsed().as_secs_f64(),
    };
    write_json(&out.join(EVAL_FILE), &report)?;
    Ok(report)
}
