//! Exports a capture for other tools.

use super::{ExportJob, ExportReport, Format, Losses, occupied};
use crate::error::OutputError;
use crate::{Error, Observer, Settings};
use m4_core::Capture;
use m4_io::ErrorKind;
use m4_io::capture::{self, CaptureOptions, Split};
use m4_io::dataset::{colmap, nerfstudio};
use std::path::Path;
use std::time::Instant;

/// Writes the capture at `input`.
pub(super) fn make(input: &Path, job: &ExportJob, observer: &dyn Observer) -> Result<ExportReport, Error> {
    let name = job.format.file_name();
    let out = match &job.out {
        Some(out) => out.clone(),
        None if input.is_dir() => input.join(name),
        None => input.parent().unwrap_or(Path::new("")).join(name),
    };
    if !job.replace && occupied(&out) {
        return Err(OutputError::WouldReplace { path: out }.into());
    }
    let options = CaptureOptions {
        reach: job.reach,
        ..Settings::fast().capture
    };
    let train = capture::read(input, Split::Train, &options, observer)?;
    // COLMAP has no place for views of other cameras
    let has_views = input.join(Split::Test.file_name()).is_file();
    let takes_views = job.format == Format::Nerfstudio;
    let test = if has_views && takes_views {
        Some(capture::read(input, Split::Test, &options, observer)?)
    } else {
        None
    };
    let start = Instant::now();
    let (bytes, mut losses) = write(&out, &train, test.as_ref(), job.format, observer)?;
    if has_views && !takes_views {
        losses.dropped.push("held-out views".to_owned());
    }
    let seconds = start.elapsed().as_secs_f64();
    Ok(ExportReport::of_capture(job.format, out, bytes, losses, seconds))
}

/// One arm a format; bytes that were written, and what they hold differently.
fn write(
    out: &Path,
    train: &Capture,
    test: Option<&Capture>,
    format: Format,
    observer: &dyn Observer,
) -> Result<(u64, Losses), Error> {
    let written = match format {
        Format::Colmap => colmap::write(out, train, observer),
        Format::Nerfstudio => nerfstudio::write(out, train, test, observer),
        other => {
            return Err(Error::Internal {
                what: format!("{} was treated as a capture format", other.name()),
            });
        }
    };
    let written = written.map_err(|error| match error.kind() {
        ErrorKind::Cancelled => STOPPED,
        _ => error.into(),
    })?;
    Ok((written.bytes, Losses::of(written.losses)))
}

const STOPPED: Error = Error::Stopped {
    stage: "export",
    saved: false,
};
