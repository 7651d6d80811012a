//! First stage: a video to a capture (poses, focal length, depth, motion masks).

use crate::folder::{self, Existing, Lock};
use crate::record::{Found, GEOMETRY_FILE, GEOMETRY_FORMAT, GeometryRecord, Input, Status, VERSION, plain_json};
use crate::settings::part_to_toml;
use crate::{Error, Job, Observer, Settings, StageEvent, hash, progress::Keeper};
use m4_io::capture::Split;
use m4_scene::{Capture, CaptureFrame, RgbImage, Video};
use m4_slam::dense::{DenseFrame, Given, InverseSearch, densify};
use m4_slam::reconstruction::{CameraMotion, SparseReconstruction};
use m4_slam::sparse;
use serde::Serialize;
use std::fs;
use std::path::Path;
use std::time::Instant;

/// Name of the stage.
pub const STAGE: &str = "geometry";

/// The settings that this stage depends on.
#[derive(Serialize)]
struct Part<'a> {
    video: &'a m4_io::video::VideoOptions,
    sparse: &'a sparse::SparseConfig,
    dense: &'a m4_slam::dense::DenseConfig,
}

impl<'a> Part<'a> {
    fn of(settings: &'a Settings) -> Self {
        Self {
            video: &settings.video,
            sparse: &settings.sparse,
            dense: &settings.dense,
        }
    }
}

/// Makes a capture of a video or a folder of pictures, or finds that it was made before.
///
/// # Errors
///
/// [`Error`]: the input cannot be read, the folder cannot be used, or nothing can be reconstructed.
pub fn make(input: &Path, capture: &Path, job: &Job<'_>) -> Result<GeometryRecord, Error> {
    if !input.exists() {
        return Err(Error::Missing {
            what: "video or folder of pictures",
            path: input.to_path_buf(),
        });
    }
    let (_lock, earlier) = open(capture, job.existing)?;
    let part = Part::of(&job.settings);
    let input_hash = hash::of_path(input)?;
    let key = hash::of_parts(&[STAGE, env!("CARGO_PKG_VERSION"), &input_hash, &part_to_toml(&part)?]);
    let mut record = GeometryRecord {
        format: GEOMETRY_FORMAT.to_owned(),
        version: VERSION,
        minute4d: env!("CARGO_PKG_VERSION").to_owned(),
        status: Status::Running,
        input: Input {
            path: input.display().to_string(),
            blake3: input_hash,
        },
        key,
        settings: plain_json(&part)?,
        found: None,
        seconds: 0.0,
        peak_memory_bytes: None,
        warnings: Vec::new(),
    };
    if let Some(earlier) = &earlier
        && earlier.key == record.key
        && earlier.status == Status::Finished
        && capture.join(Split::Train.file_name()).is_file()
    {
        job.observer.stage(STAGE, StageEvent::Reused);
        return Ok(earlier.clone());
    }
    let because = earlier.as_ref().map(|earlier| why_again(earlier, &record));
    clear(capture)?;
    record.write(capture)?;
    job.observer.stage(STAGE, StageEvent::Started { because });
    let (start, keeper) = (Instant::now(), Keeper::new(job.observer));
    let outcome = compute(input, capture, &job.settings, &keeper);
    record.seconds = start.elapsed().as_secs_f64();
    record.warnings = keeper.warnings();
    let failed = match outcome {
        Ok(found) => {
            (record.status, record.found) = (Status::Finished, Some(found));
            None
        }
        Err(error) => {
            record.status = if error.is_stop() {
                Status::Stopped
            } else {
                Status::Failed
            };
            Some(error)
        }
    };
    let written = record.write(capture);
    match failed {
        Some(error) if error.is_stop() => Err(Error::Stopped {
            stage: STAGE,
            saved: true,
        }),
        Some(error) => Err(error),
        None => {
            written?;
            let seconds = record.seconds;
            job.observer.stage(STAGE, StageEvent::Finished { seconds });
            Ok(record)
        }
    }
}

fn why_again(earlier: &GeometryRecord, now: &GeometryRecord) -> &'static str {
    if earlier.input.blake3 != now.input.blake3 {
        "because the input changed"
    } else if earlier.settings != now.settings {
        "because its settings changed"
    } else if earlier.status != Status::Finished {
        "because it was not finished"
    } else {
        "because its files are not complete or another version made them"
    }
}

/// Makes or takes over the folder of a capture; gives the earlier record where it is to be used.
fn open(capture: &Path, existing: Existing) -> Result<(Lock, Option<GeometryRecord>), Error> {
    let filled = folder::make(capture)?;
    let lock = Lock::take(capture)?;
    let earlier = if filled { take_over(capture, existing)? } else { None };
    Ok((lock, earlier))
}

fn take_over(capture: &Path, existing: Existing) -> Result<Option<GeometryRecord>, Error> {
    match (GeometryRecord::read(capture)?, existing) {
        (Some(record), Existing::Resume) => Ok(Some(record)),
        (_, Existing::Force) => Ok(None),
        // A failed attempt left nothing worth keeping.
        (Some(record), Existing::Refuse) if record.status == Status::Failed => Ok(None),
        (Some(_), Existing::Refuse) => Err(Error::Exists {
            path: capture.to_path_buf(),
            what: "a capture",
        }),
        (None, _) => Err(Error::Foreign {
            path: capture.to_path_buf(),
            missing: GEOMETRY_FILE,
        }),
    }
}

/// Removes what this stage writes, and nothing else.
pub(crate) fn clear(capture: &Path) -> Result<(), Error> {
    if GeometryRecord::read(capture)?.is_none() {
        return Ok(());
    }
    folder::remove_file(&capture.join(Split::Train.file_name()))?;
    for name in ["train", "depth", "mask"] {
        let path = capture.join(name);
        match fs::remove_dir_all(&path) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => return Err(Error::Write { path, source }),
            _ => {}
        }
    }
    folder::remove_file(&capture.join(GEOMETRY_FILE))
}

fn compute(input: &Path, folder: &Path, settings: &Settings, observer: &dyn Observer) -> Result<Found, Error> {
    let video = m4_io::video::read(input, &settings.video, observer)?;
    for warning in &video.warnings {
        observer.warn(warning);
    }
    let mut config = settings.sparse.clone();
    if config.fov_deg.is_none() && config.focal_px.is_none() {
        config.focal_px = video.focal_px;
    }
    let pictures: Vec<&RgbImage> = video.frames.iter().map(|f| &f.rgb).collect();
    let sparse = sparse::reconstruct(&pictures, &config, observer)?;
    for warning in &sparse.warnings {
        observer.warn(warning);
    }
    let flow = InverseSearch {
        config: settings.dense.flow.clone(),
    };
    let dense = densify(&pictures, &sparse, &flow, &Given::default(), &settings.dense, observer)?;
    let found = summary(&sparse, &dense);
    drop(pictures);
    let capture = assemble(video, &sparse, dense);
    m4_io::capture::write(folder, &capture, Split::Train, observer)?;
    Ok(found)
}

fn assemble(video: Video, sparse: &SparseReconstruction, dense: Vec<DenseFrame>) -> Capture {
    let n = video.frames.len();
    let first_s = video.frames.first().map_or(0.0, |f| f.time_s);
    let duration_s = video.frames.last().map_or(0.0, |f| f.time_s) - first_s;
    let last = n.saturating_sub(1) as f64;
    let moment = |i: usize, time_s: f64| {
        if duration_s > 0.0 {
            ((time_s - first_s) / duration_s * last).clamp(0.0, last)
        } else {
            i as f64
        }
    };
    let frames = video.frames.into_iter().zip(dense).zip(&sparse.cameras).enumerate();
    let frames = frames.map(|(i, ((frame, dense), camera))| CaptureFrame {
        name: format!("{i:05}"),
        camera: *camera,
        t: moment(i, frame.time_s),
        rgb: frame.rgb,
        depth: Some(dense.depth.into()),
        mask: Some(dense.mask.into()),
        camera_index: None,
    });
    Capture {
        frames: frames.collect(),
        time_frames: n,
        duration_s: (duration_s > 0.0).then_some(duration_s),
        metric: false,
    }
}

fn summary(sparse: &SparseReconstruction, dense: &[DenseFrame]) -> Found {
    let lens = sparse.cameras.first().map(|c| c.intrinsics);
    let pixels: usize = dense.iter().map(|d| d.mask.data().len()).sum();
    let moving = dense.iter().flat_map(|d| d.mask.data()).filter(|&&m| m != 0).count();
    Found {
        frames: sparse.cameras.len(),
        size: lens.map_or([0, 0], |k| [k.width, k.height]),
        focal_px: lens.map_or(0.0, |k| k.fx),
        fov_deg: lens.map_or(0.0, |k| k.horizontal_fov_rad().to_degrees()),
        camera_motion: match sparse.camera_motion {
            CameraMotion::Parallax => "parallax",
            CameraMotion::RotationOnly => "rotation_only",
            CameraMotion::Static => "static",
        }
        .to_owned(),
        residual_px: sparse.residual_px,
        tracks: sparse.tracks.len(),
        points: sparse.tracks.iter().filter(|t| t.point.is_some()).count(),
        moving_share: moving as f64 / pixels.max(1) as f64,
    }
}
