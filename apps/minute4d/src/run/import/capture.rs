//! Imports a clip with poses as a capture.

use super::{ImportJob, ImportOptions, STAGE};
use crate::run::folder::CaptureFolder;
use crate::run::record::{GeometryRecord, Source};
use crate::run::stage;
use m4_core::Capture;
use m4_io::dataset::SourceFormat;
use m4_io::{ErrorKind, ReadError};
use minute4d::enhance::moving_share;
use minute4d::import::write_capture;
use minute4d::json::plain_json;
use minute4d::observer::RecordingObserver;
use minute4d::{Error, Observer, Settings};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The report of an import.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CaptureReport {
    /// The format that was read.
    pub format: SourceFormat,
    /// The capture that was made.
    pub path: PathBuf,
    /// Its frames.
    pub frames: usize,
    /// Their size, pixels.
    pub size: [usize; 2],
    /// Horizontal field of view of the first, degrees.
    pub fov_deg: f64,
    /// Seconds from the first to the last frame.
    pub duration_s: Option<f64>,
    /// Share of pixels whose depth is known.
    pub known_share: f64,
    /// Share of pixels that move; `None` where there is no map of motion.
    pub moving_share: Option<f64>,
    /// Held-out views.
    pub held_out: usize,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// The settings in the record of the capture.
#[derive(Serialize)]
struct Dependencies<'a> {
    import: &'a ImportOptions,
    format: SourceFormat,
}

pub(super) fn make(
    file: &Path,
    out: &Path,
    format: SourceFormat,
    job: &ImportJob,
    observer: &dyn Observer,
) -> Result<CaptureReport, Error> {
    let start = Instant::now();
    let keeper = RecordingObserver::new(observer);
    let options = ImportOptions {
        max_memory_bytes: Settings::fast().capture.max_memory_bytes,
        ..job.options.clone()
    };
    // Read before the folder is made, so that a wrong file leaves nothing behind.
    if format == SourceFormat::Megasam {
        let allowed = ["--fps", "--allow-outside"];
        job.refuse_options(&allowed, format.name(), ", which has its own")?;
    }
    let imported = m4_io::dataset::read(file, format, &options, &keeper).map_err(source_stopped)?;
    let settings = plain_json(&Dependencies {
        import: &options,
        format,
    })?;
    let source = Source::read(file, None, observer)?;
    let key = stage::key(STAGE, &[&source.blake3, &settings.to_string()]);
    let mut record = GeometryRecord::begin(&source, key, settings);
    record.seconds = start.elapsed().as_secs_f64();
    record.warnings = keeper.warnings();
    let beside = [
        options.images.as_deref(),
        options.depth.as_deref(),
        options.masks.as_deref(),
    ];
    let inputs: Vec<&Path> = [file]
        .into_iter()
        .chain(beside.into_iter().flatten())
        .collect();
    let mut folder = CaptureFolder::open(out, job.existing, record, &inputs, observer)?;
    folder.stage(STAGE, |folder, steps| {
        write_capture(
            &folder.next(),
            &imported,
            (file, format),
            options.factor,
            steps.observer(),
        )
    })?;
    let held_out = imported.test.as_ref().map_or(0, |test| test.frames.len());
    Ok(report(
        format,
        out,
        &imported.train,
        held_out,
        folder.record.seconds,
    ))
}

fn source_stopped(error: ReadError) -> Error {
    match error.kind() {
        ErrorKind::Cancelled => Error::Stopped {
            stage: STAGE,
            saved: false,
        },
        _ => error.into(),
    }
}

fn report(
    format: SourceFormat,
    out: &Path,
    capture: &Capture,
    held_out: usize,
    seconds: f64,
) -> CaptureReport {
    let frames = &capture.frames;
    let lens = frames.first().map(|f| f.camera.intrinsics);
    let size = lens.map_or([0, 0], |k| [k.width, k.height]);
    let pixels = (frames.len() * size[0] * size[1]).max(1) as f64;
    let known_pixels = frames
        .iter()
        .filter_map(|f| f.depth.as_ref())
        .flat_map(|d| d.every(1))
        .filter(|z| *z > 0.0)
        .count();
    CaptureReport {
        format,
        path: out.to_path_buf(),
        frames: frames.len(),
        size,
        fov_deg: lens.map_or(0.0, |k| k.horizontal_fov_rad().to_degrees()),
        duration_s: capture.duration_s,
        known_share: known_pixels as f64 / pixels,
        moving_share: moving_share(capture),
        held_out,
        seconds,
    }
}
