//! Better masks and tracks for a capture on disk.

use super::Job;
use super::folder::CaptureFolder;
use super::record::{GeometryRecord, Source};
use super::stage;
use m4_core::Tracks;
use m4_geometry::classical::dense::DenseConfig;
use minute4d::device::NetworkDevice;
use minute4d::enhance::{self, Before, Plan};
use minute4d::json::plain_json;
use minute4d::networks::UsedNetwork;
use minute4d::observer::RecordingObserver;
use minute4d::settings::EnhanceConfig;
use minute4d::{Error, hash};
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
    /// The segmentation method: `none`, `mobilesam` or `sam2`.
    pub segmenter: String,
    /// The tracking method: `none`, `flow` or `tapip3d`.
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
struct Dependencies<'a> {
    enhance: &'a EnhanceConfig,
    dense: &'a DenseConfig,
    segmenter: &'a str,
    tracker: &'a str,
    networks: &'a [UsedNetwork],
}

/// Reads the capture `input`, refines its masks, follows points in them, and writes a capture into
/// the folder `out`.
///
/// # Errors
///
/// [`Error`]: the capture cannot be read or says nothing of the dynamic part, weights are missing, the folder cannot be used, or the user stops.
pub fn make(input: &Path, out: &Path, job: &Job<'_>) -> Result<EnhanceReport, Error> {
    Error::unless_exists("capture", input)?;
    let settings = &job.settings;
    let (segmenter, tracker) = (settings.geometry.segmenter, settings.geometry.tracker);
    let plan = Plan::of(segmenter, tracker, Before::Motion)?;
    if plan.nothing() {
        return Err(enhance::nothing_to_do());
    }
    let start = Instant::now();
    let recorder = RecordingObserver::new(job.observer);
    // Read before the folder is made, so that a wrong path leaves nothing behind.
    let capture = super::train::read(input, settings, &recorder)?;
    let part = Dependencies {
        enhance: &settings.enhance,
        dense: &settings.dense,
        segmenter: plan.segmenter(),
        tracker: plan.tracker(),
        networks: &plan.used,
    };
    let part = plain_json(&part)?;
    let source = Source {
        path: input,
        blake3: hash::of_capture(&capture),
    };
    let key = stage::key(STAGE, &[&source.blake3, &part.to_string()]);
    let mut record = GeometryRecord::begin(&source, key, part);
    record.seconds = start.elapsed().as_secs_f64();
    record.warnings = recorder.warnings();
    let before = enhance::moving_share(&capture);
    let list = if input.is_dir() {
        input
    } else {
        input.parent().unwrap_or(input)
    };
    let images: Vec<PathBuf> = capture
        .frames
        .iter()
        .map(|frame| list.join(&frame.name))
        .collect();
    let inputs: Vec<&Path> = [input]
        .into_iter()
        .chain(images.iter().map(PathBuf::as_path))
        .collect();
    let mut folder = CaptureFolder::open(out, job.existing, record, &inputs, job.observer)?;
    let (capture, instance_report) = folder.stage(STAGE, |folder, steps| {
        let device = if plan.has_network() {
            job.device.choice.for_networks()?
        } else {
            NetworkDevice::processor()
        };
        let (capture, report) = enhance::apply(capture, &plan, settings, &device, steps)?;
        enhance::write(&folder.next(), &capture, report.as_ref(), steps.observer())?;
        Ok((capture, report))
    })?;
    let seconds = folder.record.seconds;
    Ok(EnhanceReport {
        path: out.to_path_buf(),
        segmenter: plan.segmenter().to_owned(),
        tracker: plan.tracker().to_owned(),
        networks: plan.used,
        instances: instance_report.map_or(0, |report| report.instances.len()),
        moving_share: [before, enhance::moving_share(&capture)],
        tracks: capture.tracks.as_ref().map_or(0, Tracks::count),
        seconds,
    })
}
