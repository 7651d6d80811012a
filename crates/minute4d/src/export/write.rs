//! Writes files of splats, and captures for COLMAP.

use super::{ExportJob, ExportReport, Format, Losses};
use crate::{Error, Observer, Refusal, Settings};
use m4_core::Scene;
use m4_io::ErrorKind;
use m4_io::capture::{self, CaptureOptions, Split};
use m4_io::dataset::colmap;
use m4_io::scene::{Loss, Written, fourdgs, ftgs, gltf, ply, splatv, spz};
use m4_kernels::pose;
use std::path::{Path, PathBuf};
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
        Format::Ftgs => ftgs::write(out, scene)?,
        Format::Splatv => splatv::write(out, scene)?,
        Format::Ply => ply::write(out, scene, t)?,
        Format::PlySequence => {
            let mut stopped = false;
            let splats_at = |t: f64| pose::at(&scene.splats, t as f32);
            let mut written = ply::write_sequence(out, scene, moments, splats_at, |done| {
                observer.update("export", done, moments.len(), "");
                stopped = observer.cancelled();
                !stopped
            })?;
            if stopped {
                return Err(STOPPED);
            }
            if !scene.splats.bindings().is_empty() {
                let bound = scene.splats.bindings().len();
                let what = format!(
                    "the motion of {bound} splats that nodes carry, at {} instants",
                    moments.len()
                );
                written.losses.insert(0, Loss::Baked(what));
            }
            written
        }
        Format::Spz => spz::write(out, scene, t)?,
        Format::Gltf => gltf::write(out, scene, t)?,
        Format::Colmap => return Err(needs_capture(job.format).into()),
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

pub(super) fn make_capture(
    input: &Path,
    out: PathBuf,
    job: &ExportJob,
    observer: &dyn Observer,
) -> Result<ExportReport, Error> {
    let options = CaptureOptions {
        reach: job.reach,
        ..Settings::fast().capture
    };
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
    Ok(ExportReport {
        format: job.format,
        path: out,
        bytes: written.bytes,
        splats: 0,
        bytes_per_splat: None,
        bytes_per_s: None,
        moments: Vec::new(),
        encode_s: start.elapsed().as_secs_f64(),
        losses,
    })
}

const STOPPED: Error = Error::Stopped {
    stage: "export",
    saved: false,
};
