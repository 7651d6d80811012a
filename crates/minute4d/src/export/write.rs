//! Writes files of splats, captures for COLMAP, and videos.

use super::{ExportJob, ExportReport, Format, Losses, occupied};
use crate::error::OutputError;
use crate::render::{Painter, source_fps};
use crate::{Error, Observer, Refusal, Settings};
use m4_core::Scene;
use m4_io::ErrorKind;
use m4_io::capture::{self, CaptureOptions, Split};
use m4_io::dataset::colmap;
use m4_io::scene::{Loss, Written, fourdgs, gltf, ply, splatv, spz};
use m4_io::video::Mp4Writer;
use m4_kernels::SimdLevel;
use std::path::Path;
use std::time::Instant;

/// Writes `scene` to `out`; `moments` are those of [`ExportJob::moments`].
pub(super) fn write(
    scene: &Scene,
    out: &Path,
    moments: &[f64],
    job: &ExportJob,
    observer: &dyn Observer,
) -> Result<Written, Error> {
    let t = moments.first().copied().unwrap_or(0.0);
    let written = match job.format {
        Format::Fourdgs => fourdgs::write(out, scene)?,
        Format::Splatv => splatv::write(out, scene)?,
        Format::Ply => ply::write(out, scene, t)?,
        Format::PlySequence => {
            let mut stopped = false;
            let written = ply::write_sequence(out, scene, moments, |done| {
                observer.update("export", done, moments.len(), "");
                stopped = observer.cancelled();
                !stopped
            })?;
            if stopped {
                return Err(STOPPED);
            }
            written
        }
        Format::Spz => spz::write(out, scene, t)?,
        Format::Gltf => gltf::write(out, scene, t)?,
        Format::Colmap => return Err(needs_capture(job.format).into()),
        Format::Mp4 => write_video(out, scene, job.fps, observer)?,
    };
    Ok(written)
}

/// The refusal of a scene for a format that holds captures.
pub(super) fn needs_capture(format: Format) -> Refusal {
    Refusal::bad_input(format!(
        "the format {} stores captures, not scenes; give the folder of a capture, or choose a format of scenes such as ply",
        format.name()
    ))
}

/// Renders every camera of the source at its own moment, with its exposure, in the order of time.
fn write_video(out: &Path, scene: &Scene, fps: Option<f64>, observer: &dyn Observer) -> Result<Written, Error> {
    let size = match scene.source.first() {
        Some(first) => first.camera.intrinsics,
        None => {
            let message = "the scene has no cameras to render it from; render it along a path, such as --path swing";
            return Err(Refusal::bad_input(message).into());
        }
    };
    let mut painter = Painter::new(scene, SimdLevel::detect()?);
    let fps = fps.unwrap_or_else(|| source_fps(scene));
    let mut writer = Mp4Writer::create(out, size.width, size.height, fps)?;
    for (i, frame) in scene.source.iter().enumerate() {
        if observer.cancelled() {
            return Err(STOPPED);
        }
        let camera = frame.camera.resized(size.width, size.height);
        writer.push(&painter.image(&camera, frame.t, &frame.exposure))?;
        observer.update("export", i + 1, scene.source.len(), "");
    }
    writer.finish()?;
    let bytes = std::fs::metadata(out).map_err(|source| Error::Read { path: out.to_path_buf(), source })?.len();
    Ok(Written {
        path: out.to_path_buf(),
        bytes,
        splats: 0,
        losses: vec![Loss::Baked(format!("everything, into {} images", scene.source.len()))],
    })
}

pub(super) fn make_capture(input: &Path, job: &ExportJob, observer: &dyn Observer) -> Result<ExportReport, Error> {
    let name = job.format.file_name();
    let out = match &job.out {
        Some(out) => out.clone(),
        None if input.is_dir() => input.join(name),
        None => input.parent().unwrap_or(Path::new("")).join(name),
    };
    if !job.replace && occupied(&out) {
        return Err(OutputError::WouldReplace { path: out }.into());
    }
    let options = CaptureOptions { reach: job.reach, ..Settings::fast().capture };
    let train = capture::read(input, Split::Train, &options, observer)?;
    let start = Instant::now();
    let written = colmap::write(&out, &train, observer).map_err(|error| match error.kind() {
        ErrorKind::Cancelled => STOPPED,
        _ => error.into(),
    })?;
    let mut losses = Losses::of(written.losses);
    // COLMAP has no place for views of other cameras
    if input.join(Split::Test.file_name()).is_file() {
        losses.dropped.push("held-out views".to_owned());
    }
    let seconds = start.elapsed().as_secs_f64();
    Ok(ExportReport::of_capture(job.format, out, written.bytes, losses, seconds))
}

const STOPPED: Error = Error::Stopped { stage: "export", saved: false };
