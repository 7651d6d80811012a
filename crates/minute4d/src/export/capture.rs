//! A capture as files of MegaSaM.

use super::{ExportError, ExportJob, ExportReport, occupied};
use crate::folder::CAPTURE_FOLDER;
use crate::{Error, Observer, Settings, is_capture};
use m4_io::capture::{self, Split};
use m4_io::megasam::{self, Layout, WriteMegasamError};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Writes the training frames of the capture at `input`, or of the one in the folder of a run.
pub(super) fn make(
    input: &Path,
    layout: Layout,
    job: &ExportJob,
    observer: &dyn Observer,
) -> Result<ExportReport, Error> {
    let found = find(input, job)?;
    let out = match &job.out {
        Some(out) => out.clone(),
        None if input.is_dir() => input.join(job.format.file_name()),
        None => input.parent().unwrap_or(Path::new("")).join(job.format.file_name()),
    };
    if !job.replace && occupied(&out) {
        return Err(Error::WouldReplace { path: out });
    }
    let capture = capture::read(&found, Split::Train, &Settings::fast().capture, observer)?;
    let start = Instant::now();
    let written = megasam::write(&out, &capture, layout, observer).map_err(|error| match error {
        WriteMegasamError::Cancelled { .. } => Error::Stopped {
            stage: "export",
            saved: false,
        },
        other => ExportError::from(other).into(),
    })?;
    let seconds = start.elapsed().as_secs_f64();
    Ok(ExportReport::of_capture(job.format, out, written, seconds))
}

/// The capture that is meant.
fn find(input: &Path, job: &ExportJob) -> Result<PathBuf, Error> {
    if !input.exists() {
        return Err(Error::Missing {
            what: "capture",
            path: input.to_path_buf(),
        });
    }
    let inside = input.join(CAPTURE_FOLDER);
    match [input.to_path_buf(), inside].into_iter().find(|path| is_capture(path)) {
        Some(path) => Ok(path),
        None => Err(ExportError::NeedsCapture {
            format: job.format,
            path: Some(input.to_path_buf()),
        }
        .into()),
    }
}
