//! `minute4d enhance`: improves the masks of a capture and tracks points.

use super::apply::apply;
use super::plan::{Before, Plan};
use super::{EnhanceError, save};
use crate::device::NetworkDevice;
use crate::geometry::{self, UsedNetwork};
use crate::progress::RecordingObserver;
use crate::record::{GEOMETRY_FORMAT, GeometryRecord, Input, Status, VERSION, plain_json};
use crate::steps::Steps;
use crate::{Error, Job, StageEvent, hash};
use m4_core::CompactMask;
use m4_geometry::dense::DenseConfig;
use m4_io::capture::Split;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Name of the stage.
pub const STAGE: &str = "enhance";

/// What was done to a capture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EnhanceReport {
    /// The capture that was made.
    pub path: PathBuf,
    /// The segmentation method: `none`, `flow`, `mobilesam` or `sam2`.
    pub segmenter: String,
    /// Who followed points: `none`, `flow` or `tapip3d`.
    pub tracker: String,
    /// Networks that took part.
    pub networks: Vec<UsedNetwork>,
    /// Number of objects.
    pub instances: usize,
    /// Share of all pixels that move, before and after; `None` where the capture had no masks.
    pub moving_share: [Option<f64>; 2],
    /// Points that were followed.
    pub tracks: usize,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// The settings that this stage depends on.
#[derive(Serialize)]
struct Part<'a> {
    enhance: &'a super::EnhanceConfig,
    dense: &'a DenseConfig,
    segmenter: &'a str,
    tracker: &'a str,
    networks: &'a [UsedNetwork],
}

/// Reads the capture `input`, refines its masks, follows points in them, and writes a capture into the folder `out`.
///
/// # Errors
///
/// [`Error`]: the capture cannot be read or says nothing of the dynamic part, weights are missing, the folder cannot be used, or the user stops.
pub fn make(input: &Path, out: &Path, job: &Job<'_>) -> Result<EnhanceReport, Error> {
    if !input.exists() {
        return Err(Error::Missing {
            what: "capture",
            path: input.to_path_buf(),
        });
    }
    let settings = &job.settings;
    let (segmenter, tracker) = (settings.geometry.segmenter, settings.geometry.tracker);
    let plan = Plan::of(segmenter, tracker, Before::Motion)?;
    if plan.nothing() {
        return Err(EnhanceError::NothingToDo.into());
    }
    let start = Instant::now();
    let keeper = RecordingObserver::new(job.observer);
    // Read before the folder is made, so that a wrong path leaves nothing behind.
    let capture = crate::train::read(input, settings, &keeper)?;
    let part = Part {
        enhance: &settings.enhance,
        dense: &settings.dense,
        segmenter: plan.segmenter(),
        tracker: plan.tracker(),
        networks: &plan.used,
    };
    let (written, source) = (
        plain_json(&part)?,
        Input {
            path: input.display().to_string(),
            blake3: hash::of_capture(&capture),
        },
    );
    let (_lock, earlier) = geometry::open(out, job.existing)?;
    let key = hash::of_parts(&[STAGE, env!("CARGO_PKG_VERSION"), &source.blake3, &written.to_string()]);
    let mut record = GeometryRecord {
        format: GEOMETRY_FORMAT.to_owned(),
        version: VERSION,
        minute4d: env!("CARGO_PKG_VERSION").to_owned(),
        status: Status::Running,
        input: source,
        key,
        settings: written,
        found: None,
        seconds: 0.0,
        peak_memory_bytes: None,
        warnings: Vec::new(),
    };
    let because = earlier.is_some_and(|earlier| earlier.key == record.key && earlier.status != Status::Finished);
    let because = because.then_some("because it was not finished; its finished steps are used");
    record.write(out)?;
    geometry::clear_results(out)?;
    job.observer.stage(STAGE, StageEvent::Started { because });
    let steps = Steps::open(out, &record.key, &keeper);
    let device = if plan.has_network() {
        job.device.choice.for_networks()?
    } else {
        NetworkDevice::processor()
    };
    let before = moving_share(&capture);
    let outcome = apply(capture, &plan, settings, &device, &steps).and_then(|(capture, found)| {
        match &found {
            Some(report) => save(out, &capture, report, &keeper)?,
            None => m4_io::capture::write(out, &capture, Split::Train, &keeper)?,
        }
        Ok((capture, found))
    });
    record.seconds = start.elapsed().as_secs_f64();
    record.warnings = keeper.warnings();
    record.status = match &outcome {
        Ok(_) => Status::Finished,
        Err(error) if error.is_stop() => Status::Stopped,
        Err(_) => Status::Failed,
    };
    if outcome
        .as_ref()
        .err()
        .is_none_or(|error| !error.is_stop() && !error.may_pass())
    {
        steps.remove();
    }
    let written = record.write(out);
    let (capture, found) = outcome?;
    written?;
    let seconds = record.seconds;
    job.observer.stage(STAGE, StageEvent::Finished { seconds });
    Ok(EnhanceReport {
        path: out.to_path_buf(),
        segmenter: plan.segmenter().to_owned(),
        tracker: plan.tracker().to_owned(),
        networks: plan.used,
        instances: found.map_or(0, |report| report.instances.len()),
        moving_share: [before, moving_share(&capture)],
        tracks: capture.tracks.as_ref().map_or(0, m4_core::Tracks::count),
        seconds,
    })
}

fn moving_share(capture: &m4_core::Capture) -> Option<f64> {
    let masks = || capture.frames.iter().filter_map(|frame| frame.mask.as_ref());
    let pixels: usize = masks().map(|mask| mask.size().0 * mask.size().1).sum();
    let moving: usize = masks().map(CompactMask::count).sum();
    (pixels > 0).then(|| moving as f64 / pixels as f64)
}
