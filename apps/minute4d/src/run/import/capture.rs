//! Imports a clip with poses as a capture.

use super::{ImportJob, ImportOptions, STAGE};
use crate::run::folder::CaptureFolder;
use crate::run::record::{GeometryRecord, Source};
use crate::run::stage;
use m4_core::{Capture, CompactMask, Progress};
use m4_io::capture::{self, Split};
use m4_io::dataset::dycheck;
use m4_io::dataset::{Imported, SourceFormat};
use m4_io::image::{read_mask, write_mask};
use m4_io::{ErrorKind, ReadError};
use minute4d::json::plain_json;
use minute4d::layout::COVISIBLE_FOLDER;
use minute4d::observer::RecordingObserver;
use minute4d::{Error, Observer, Refusal, Settings};
use serde::Serialize;
use std::fs;
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
        check_megasam(&options)?;
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
        write(
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

/// Writes the held-out views with the masks of co-visibility that their data set publishes, then
/// the frames.
pub fn write(
    out: &Path,
    imported: &Imported,
    (source, format): (&Path, SourceFormat),
    factor: Option<u32>,
    observer: &dyn Progress,
) -> Result<(), Error> {
    if let Some(test) = &imported.test {
        capture::write(out, test, Split::Test, observer)?;
        if format == SourceFormat::Dycheck {
            let masks = copy_covisible(out, test, |name| dycheck::covisible(source, name, factor))?;
            // Nerfies and HyperNeRF publish none
            if (1..test.frames.len()).contains(&masks) {
                observer.warn(&format!(
                    "{} of {} views of {} have no published co-visibility mask",
                    test.frames.len() - masks,
                    test.frames.len(),
                    source.display()
                ));
            }
        }
    }
    Ok(capture::write(
        out,
        &imported.train,
        Split::Train,
        observer,
    )?)
}

/// Refuses options of what the files of MegaSaM hold themselves.
fn check_megasam(options: &ImportOptions) -> Result<(), Refusal> {
    let beside = [
        ("--images", options.images.is_some()),
        ("--depth", options.depth.is_some()),
        ("--masks", options.masks.is_some()),
        ("--factor", options.factor.is_some()),
    ];
    match beside.into_iter().find(|(_, is_given)| *is_given) {
        Some((option, _)) => {
            let format = SourceFormat::Megasam.name();
            Err(Refusal::usage(format!(
                "{option} has no meaning for {format}, which has its own; leave it out"
            )))
        }
        None => Ok(()),
    }
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
    let masks = || frames.iter().filter_map(|f| f.mask.as_ref());
    let n_dynamic: usize = masks().map(CompactMask::count).sum();
    CaptureReport {
        format,
        path: out.to_path_buf(),
        frames: frames.len(),
        size,
        fov_deg: lens.map_or(0.0, |k| k.horizontal_fov_rad().to_degrees()),
        duration_s: capture.duration_s,
        known_share: known_pixels as f64 / pixels,
        moving_share: masks().next().map(|_| n_dynamic as f64 / pixels),
        held_out,
        seconds,
    }
}

/// Copies published masks into a capture: `from(name)` is the file of a view, whose name in the
/// capture is that of its image. Files that do not exist are passed over; says how many were
/// copied.
fn copy_covisible(
    capture: &Path,
    views: &Capture,
    from: impl Fn(&str) -> PathBuf,
) -> Result<usize, Error> {
    let folder = capture.join(COVISIBLE_FOLDER);
    let mut copied = 0;
    for (i, view) in views.frames.iter().enumerate() {
        let source = from(&view.name);
        if !source.is_file() {
            continue;
        }
        let mask = read_mask(&source)?.to_mask();
        if copied == 0 {
            fs::create_dir_all(&folder).map_err(Error::write(&folder))?;
        }
        write_mask(&folder.join(format!("{i:05}.png")), &mask)?;
        copied += 1;
    }
    Ok(copied)
}
