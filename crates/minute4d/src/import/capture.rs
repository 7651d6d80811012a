//! Files of MegaSaM as a capture.

use super::{ImportError, ImportJob, STAGE};
use crate::export::Format;
use crate::progress::Keeper;
use crate::record::{GEOMETRY_FORMAT, GeometryRecord, Input, Status, VERSION, plain_json};
use crate::{Error, Observer, Settings, StageEvent, geometry, hash};
use m4_io::capture::{self, Split};
use m4_io::megasam::{self, MegasamFault, MegasamOptions, ReadMegasamError};
use m4_scene::{Capture, CompactMask};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What was imported.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CaptureReport {
    /// The format that was read.
    pub format: Format,
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
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// The settings in the record of the capture.
#[derive(Serialize)]
struct Part<'a> {
    import: &'a MegasamOptions,
    format: Format,
}

/// Reads `file` and writes a capture into the folder `out`.
pub(super) fn make(
    file: &Path,
    out: &Path,
    format: Format,
    job: &ImportJob,
    observer: &dyn Observer,
) -> Result<CaptureReport, Error> {
    let start = Instant::now();
    let keeper = Keeper::new(observer);
    let defaults = MegasamOptions::default();
    let options = MegasamOptions {
        fps: job.fps,
        tau_motion: job.tau_motion.unwrap_or(defaults.tau_motion),
        motion: job.motion.clone(),
        max_memory_bytes: Settings::fast().capture.max_memory_bytes,
    };
    // Read before the folder is made, so that a wrong file leaves nothing behind.
    observer.stage(STAGE, StageEvent::Started { because: None });
    let capture = megasam::read(file, &options, &keeper).map_err(stopped)?;
    let part = Part {
        import: &options,
        format,
    };
    let settings = plain_json(&part)?;
    let input = Input {
        path: file.display().to_string(),
        blake3: hash::of_path(file)?,
    };
    let (_lock, _) = geometry::open(out, job.existing)?;
    geometry::clear(out)?;
    let key = hash::of_parts(&[STAGE, env!("CARGO_PKG_VERSION"), &input.blake3, &settings.to_string()]);
    let mut record = GeometryRecord {
        format: GEOMETRY_FORMAT.to_owned(),
        version: VERSION,
        minute4d: env!("CARGO_PKG_VERSION").to_owned(),
        status: Status::Running,
        input,
        key,
        settings,
        found: None,
        seconds: 0.0,
        peak_memory_bytes: None,
        warnings: Vec::new(),
    };
    record.write(out)?;
    let written = capture::write(out, &capture, Split::Train, &keeper);
    record.seconds = start.elapsed().as_secs_f64();
    record.warnings = keeper.warnings();
    record.status = match &written {
        Ok(()) => Status::Finished,
        Err(_) => Status::Failed,
    };
    record.write(out)?;
    written?;
    observer.stage(
        STAGE,
        StageEvent::Finished {
            seconds: record.seconds,
        },
    );
    Ok(report(format, out, &capture, record.seconds))
}

fn stopped(error: ReadMegasamError) -> Error {
    match error.fault {
        MegasamFault::Cancelled => Error::Stopped {
            stage: STAGE,
            saved: false,
        },
        _ => ImportError::from(error).into(),
    }
}

fn report(format: Format, out: &Path, capture: &Capture, seconds: f64) -> CaptureReport {
    let frames = &capture.frames;
    let lens = frames.first().map(|f| f.camera.intrinsics);
    let size = lens.map_or([0, 0], |k| [k.width, k.height]);
    let pixels = (frames.len() * size[0] * size[1]).max(1) as f64;
    let known = frames
        .iter()
        .filter_map(|f| f.depth.as_ref())
        .flat_map(|d| d.every(1))
        .filter(|z| *z > 0.0)
        .count();
    let masks = || frames.iter().filter_map(|f| f.mask.as_ref());
    let moving: usize = masks().map(CompactMask::count).sum();
    CaptureReport {
        format,
        path: out.to_path_buf(),
        frames: frames.len(),
        size,
        fov_deg: lens.map_or(0.0, |k| k.horizontal_fov_rad().to_degrees()),
        duration_s: capture.duration_s,
        known_share: known as f64 / pixels,
        moving_share: masks().next().map(|_| moving as f64 / pixels),
        seconds,
    }
}
