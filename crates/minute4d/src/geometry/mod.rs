//! The first stage: turns a video into a capture (poses, focal length, depth, motion masks).
//!
//! ```text
//! video, and what the user provides (given) -> frames
//!   --sparse--> cameras, tracks, points --dense, with flow of a front end--> depth, masks --> capture
//!              ^                                                            |    '-> confidence
//!              '---- once more without what is masked (iterate) ------------'
//! ```
//!
//! Finished steps are kept in the folder until the stage is done, so that an interrupted stage can be resumed.
//!
//! This file handles the record and the folder; `compute` does the work, `frontend` chooses the methods for cameras, flow and depth, `segmenter`
//! the segmentation method, `given` reads geometry that the user provides, and `confidence` grades the result.

mod between;
mod compute;
mod confidence;
mod error;
mod frontend;
mod given;
mod iterate;
mod kept;
#[cfg(feature = "nets")]
mod megasam;
mod options;
mod scale;
mod segmenter;

pub use confidence::{Confidence, Focal, Grade};
pub use error::ReconstructionError;
pub use frontend::{Frontend, Part as FrontendPart, UnknownFrontend, UsedNetwork};
pub use given::GivenError;
pub use options::GeometryOptions;
pub use segmenter::Segmenter;
pub(crate) use segmenter::resolve as resolve_segmenter;

use crate::device::NetworkDevice;
use crate::enhance::{self, Before, EnhanceConfig, Tracker};
use crate::error::OutputError;
use crate::folder::{self, Existing, Lock};
use crate::record::{GEOMETRY_FILE, GEOMETRY_FORMAT, GeometryRecord, Input, Status, VERSION, plain_json};
use crate::settings::part_to_toml;
use crate::steps::{self, Steps};
use crate::{Error, Job, StageEvent, hash, progress::RecordingObserver};
use compute::compute;
use frontend::Cameras;
use given::Sources;
use m4_core::Progress;
use m4_io::capture::{Split, TRACKS_FILE};
use serde::Serialize;
use std::path::Path;
use std::time::Instant;

/// Name of the stage.
pub const STAGE: &str = "geometry";

/// The settings that this stage depends on.
#[derive(Serialize)]
struct Part<'a> {
    video: &'a m4_io::video::VideoOptions,
    sparse: &'a m4_geometry::sparse::SparseConfig,
    dense: &'a m4_geometry::dense::DenseConfig,
    /// Of random samples.
    seed: u64,
    /// The requested value.
    geometry: &'a GeometryOptions,
    /// What that came to: the front end's name, and the hashes of its weights.
    frontend: &'a str,
    weights: Vec<&'a str>,
    /// Where it has a way of its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    megasam: Option<&'a m4_geometry::megasam::MegasamSettings>,
    /// Where networks run: another device gives other last bits.
    device: &'a str,
    /// The same of what outlines the dynamic part.
    segmenter: &'a str,
    segmenter_weights: Option<&'a str>,
    /// What is done to its result, and by which networks.
    #[serde(skip_serializing_if = "Option::is_none")]
    enhance: Option<(&'a EnhanceConfig, &'a [UsedNetwork])>,
    /// Hashes of what the user gave.
    given: Sources,
}

/// Makes a capture of a video or a folder of images, or finds that it was made before.
///
/// # Errors
///
/// [`Error`]: the input cannot be read, the folder cannot be used, or nothing can be reconstructed.
pub fn make(input: &Path, capture: &Path, job: &Job<'_>) -> Result<GeometryRecord, Error> {
    if !input.exists() {
        return Err(Error::Missing {
            what: "video or folder of images",
            path: input.to_path_buf(),
        });
    }
    let (_lock, earlier) = open(capture, job.existing)?;
    let mut settings = job.settings.clone();
    // flow tracks are computed with the depth, unless another method tracks points afterwards
    settings.dense.tracks &= !matches!(settings.geometry.tracker, Tracker::None | Tracker::Tapip3d);
    let settings = &settings;
    let plan = frontend::plan(&settings.geometry.frontend, job.device.choice)?;
    let (asked, before) = match plan.cameras {
        // What its map of motion means is found afterwards.
        Cameras::Megasam => (Segmenter::None, Before::Motion),
        Cameras::Corners => (settings.geometry.segmenter, Before::Classical),
    };
    let segmenter = segmenter::resolve(asked)?;
    let enhance = match &settings.geometry.masks {
        // masks that the user gave stay
        Some(_) => enhance::Plan::of(Segmenter::None, settings.geometry.tracker, before)?,
        None => enhance::Plan::of(settings.geometry.segmenter, settings.geometry.tracker, before)?,
    };
    let device = if plan.used.is_empty() && !enhance.has_network() {
        // A GPU that is not needed is not started, and does not count as a difference between results.
        NetworkDevice::processor()
    } else {
        job.device.choice.for_networks()?
    };
    let name = plan.frontend.to_string();
    let part = Part {
        video: &settings.video,
        sparse: &settings.sparse,
        dense: &settings.dense,
        seed: settings.sparse.seed,
        geometry: &settings.geometry,
        frontend: &name,
        weights: plan.hashes(),
        megasam: (plan.cameras == Cameras::Megasam).then_some(&settings.megasam),
        device: device.name(),
        segmenter: segmenter.name(),
        segmenter_weights: segmenter.weights_hash(),
        enhance: (!enhance.nothing()).then_some((&settings.enhance, enhance.used.as_slice())),
        given: Sources::of(&settings.geometry)?,
    };
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
    // First: a folder with anything of ours in it always has a record.
    record.write(capture)?;
    clear_results(capture)?;
    job.observer.stage(STAGE, StageEvent::Started { because });
    let (start, keeper) = (Instant::now(), RecordingObserver::new(job.observer));
    let steps = Steps::open(capture, &record.key, &keeper);
    for note in &plan.notes {
        keeper.warn(note);
    }
    let outcome = compute(
        input, capture, settings, &plan, &segmenter, &enhance, &device, &steps, &keeper,
    );
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
    if failed
        .as_ref()
        .is_none_or(|error| !error.is_stop() && !error.may_pass())
    {
        steps.remove();
    }
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
        "because it was not finished; its finished steps are used"
    } else {
        "because its files are not complete or another version made them"
    }
}

/// Makes or takes over the folder of a capture; gives the earlier record where it is to be used.
pub(crate) fn open(capture: &Path, existing: Existing) -> Result<(Lock, Option<GeometryRecord>), Error> {
    let filled = folder::make(capture)?;
    let lock = Lock::take(capture)?;
    let earlier = if filled { take_over(capture, existing)? } else { None };
    let own = [
        GEOMETRY_FILE,
        Split::Train.file_name(),
        TRACKS_FILE,
        enhance::REPORT_FILE,
    ];
    for path in folder::half_written(capture, &own)? {
        folder::remove_file(&path)?;
    }
    Ok((lock, earlier))
}

fn take_over(capture: &Path, existing: Existing) -> Result<Option<GeometryRecord>, Error> {
    match (GeometryRecord::read(capture)?, existing) {
        (Some(record), Existing::Resume) => Ok(Some(record)),
        (_, Existing::Force) => Ok(None),
        // A failed attempt left nothing worth keeping.
        (Some(record), Existing::Refuse) if record.status == Status::Failed => Ok(None),
        (Some(_), Existing::Refuse) => Err(OutputError::Exists {
            path: capture.to_path_buf(),
            what: "a capture",
        }
        .into()),
        (None, _) => Err(OutputError::NotOurs {
            path: capture.to_path_buf(),
            missing: GEOMETRY_FILE,
        }
        .into()),
    }
}

/// Removes a list of frames and what it names.
pub(crate) fn clear_split(capture: &Path, split: Split) -> Result<(), Error> {
    folder::remove_file(&capture.join(split.file_name()))?;
    for name in split.folders() {
        folder::remove_folder(&capture.join(name))?;
    }
    Ok(())
}

/// Removes what this stage writes, and nothing else.
pub(crate) fn clear(capture: &Path) -> Result<(), Error> {
    if GeometryRecord::read(capture)?.is_none() {
        return Ok(());
    }
    clear_results(capture)?;
    steps::remove(capture);
    folder::remove_file(&capture.join(GEOMETRY_FILE))
}

/// The same but for the record and the finished steps.
pub(crate) fn clear_results(capture: &Path) -> Result<(), Error> {
    clear_split(capture, Split::Train)?;
    folder::remove_file(&capture.join(TRACKS_FILE))?;
    folder::remove_file(&capture.join(enhance::REPORT_FILE))
}
