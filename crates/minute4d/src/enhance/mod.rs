//! Better masks for a capture (Minute4D sec. 3.2): dynamic objects are separated, segmented and tracked through the clip.
//!
//! ```text
//! capture (motion maps, or masks) --m4_geometry::masks, with an object tracker--> capture (masks, instances), report
//! ```
//!
//! [`make`] is `minute4d enhance`, which also follows points in the new masks ([`m4_geometry::tracks`]); the geometry stage does the same to
//! what its front ends find.

mod masks;
#[cfg(feature = "nets")]
mod networks;
mod plan;

pub use masks::masks;
pub(crate) use masks::{REPORT_FILE, write};
pub(crate) use plan::{Before, Plan};
pub use plan::{EnhanceConfig, Tapip3dConfig, Tracker};

use crate::device::NetworkDevice;
#[cfg(feature = "nets")]
use crate::error::NetworkMethod;
use crate::folder::CaptureFolder;
use crate::geometry::UsedNetwork;
#[cfg(feature = "nets")]
use crate::geometry::{Segmenter, resolve_segmenter, unusable};
use crate::record::{GeometryRecord, Input, plain_json};
use crate::stage::RecordingObserver;
use crate::steps::Steps;
use crate::{Category, Error, Job, Refusal, Settings, hash};
use m4_core::{Capture, CompactIds, CompactMask, Progress, Tracks};
use m4_geometry::classical::dense::DenseConfig;
#[cfg(feature = "nets")]
use m4_geometry::masks::FlowFollower;
use m4_geometry::masks::{InstanceError, InstanceReport};
use m4_geometry::tracks::{CaptureClip, QueryGrid, TrackError, follow};
use plan::{Segmentation, Tracking};
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
struct Part<'a> {
    enhance: &'a EnhanceConfig,
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
        return Err(Error::Missing { what: "capture", path: input.to_path_buf() });
    }
    let settings = &job.settings;
    let (segmenter, tracker) = (settings.geometry.segmenter, settings.geometry.tracker);
    let plan = Plan::of(segmenter, tracker, Before::Motion)?;
    if plan.nothing() {
        return Err(nothing_to_do());
    }
    let start = Instant::now();
    let recorder = RecordingObserver::new(job.observer);
    // Read before the folder is made, so that a wrong path leaves nothing behind.
    let capture = crate::train::read(input, settings, &recorder)?;
    let part = Part {
        enhance: &settings.enhance,
        dense: &settings.dense,
        segmenter: plan.segmenter(),
        tracker: plan.tracker(),
        networks: &plan.used,
    };
    let part = plain_json(&part)?;
    let source = Input { path: input.display().to_string(), blake3: hash::of_capture(&capture) };
    let key = hash::of_parts(&[STAGE, env!("CARGO_PKG_VERSION"), &source.blake3, &part.to_string()]);
    let mut record = GeometryRecord::begin(source, key, part);
    record.seconds = start.elapsed().as_secs_f64();
    record.warnings = recorder.warnings();
    let before = moving_share(&capture);
    let list = if input.is_dir() { input } else { input.parent().unwrap_or(input) };
    let images: Vec<PathBuf> = capture.frames.iter().map(|frame| list.join(&frame.name)).collect();
    let inputs: Vec<&Path> = [input].into_iter().chain(images.iter().map(PathBuf::as_path)).collect();
    let mut folder = CaptureFolder::open(out, job.existing, record, &inputs, job.observer)?;
    let (capture, found) = folder.stage(STAGE, |folder, steps| {
        let device = if plan.has_network() { job.device.choice.for_networks()? } else { NetworkDevice::processor() };
        let (capture, found) = apply(capture, &plan, settings, &device, steps)?;
        write(&folder.next(), &capture, found.as_ref(), steps.observer())?;
        Ok((capture, found))
    })?;
    let seconds = folder.record.seconds;
    Ok(EnhanceReport {
        path: out.to_path_buf(),
        segmenter: plan.segmenter().to_owned(),
        tracker: plan.tracker().to_owned(),
        networks: plan.used,
        instances: found.map_or(0, |report| report.instances.len()),
        moving_share: [before, moving_share(&capture)],
        tracks: capture.tracks.as_ref().map_or(0, Tracks::count),
        seconds,
    })
}

/// Share of the pixels in masks; `None` without masks.
pub(crate) fn moving_share(capture: &Capture) -> Option<f64> {
    let masks = || capture.frames.iter().filter_map(|frame| frame.mask.as_ref());
    let pixels: usize = masks().map(|mask| mask.size().0 * mask.size().1).sum();
    let moving: usize = masks().map(CompactMask::count).sum();
    (pixels > 0).then(|| moving as f64 / pixels as f64)
}

/// The refusal of a plan without a method, or none that is available.
fn nothing_to_do() -> Error {
    let message =
        "there is nothing to do: --segmenter none and --tracker none leave a capture unchanged; omit one of them";
    Refusal::usage(message).into()
}

/// Refines masks, then tracks points in them, each a step; returns the statistics of objects if a method tracked them.
pub(crate) fn apply(
    mut capture: Capture,
    plan: &Plan,
    settings: &Settings,
    device: &NetworkDevice,
    steps: &Steps<'_>,
) -> Result<(Capture, Option<InstanceReport>), Error> {
    let mut report = None;
    if plan.segmentation != Segmentation::Unchanged {
        // The report as text, the form in which it is written in the end: its variants are distinguished by names.
        let (frames, text): (Vec<_>, String) = steps.keep("masks", |progress| {
            let (frames, report) = segmented(&capture, &plan.segmentation, settings, device, progress)?;
            Ok::<_, Error>((frames, plain_json(&report)?.to_string()))
        })?;
        for (frame, (mask, ids)) in capture.frames.iter_mut().zip(frames) {
            (frame.mask, frame.instances) = (Some(mask), Some(ids));
        }
        let read = serde_json::from_str(&text).map_err(|e| Error::Internal { what: e.to_string() })?;
        report = Some(read);
    }
    let follows = match plan.tracking {
        Tracking::Unchanged => false,
        Tracking::Flow => settings.dense.tracks,
        #[cfg(feature = "nets")]
        Tracking::Tapip3d(_) => true,
    };
    if follows {
        let found = steps.keep("tracks", |progress| tracked(&capture, &plan.tracking, settings, device, progress))?;
        capture.tracks = (found.count() > 0).then_some(found);
    }
    Ok((capture, report))
}

/// Refined masks and numbers of objects, by the method that tracks objects.
#[cfg_attr(not(feature = "nets"), expect(unused_variables, reason = "only networks need it"))]
fn segmented(
    capture: &Capture,
    method: &Segmentation,
    settings: &Settings,
    device: &NetworkDevice,
    progress: &dyn Progress,
) -> Result<(Vec<(CompactMask, CompactIds)>, InstanceReport), Error> {
    #[cfg(feature = "nets")]
    let (images, config): (Vec<_>, _) =
        (capture.frames.iter().map(|frame| &frame.rgb).collect(), &settings.enhance.masks);
    match method {
        Segmentation::Unchanged => Err(nothing_to_do()),
        #[cfg(feature = "nets")]
        Segmentation::Mobilesam => {
            let segmenter = resolve_segmenter(Segmenter::Mobilesam)?.load()?;
            let outlines = segmenter.as_deref().map(|segmenter| ("mobilesam+classical", segmenter));
            masks(capture, config, |size| Ok(Box::new(FlowFollower::new(&images, size, outlines))), progress)
        }
        #[cfg(feature = "nets")]
        Segmentation::Sam2(path) => {
            let method = NetworkMethod::Segmenter(Segmenter::Sam2);
            let net = m4_nets::Sam2::load(path, &device.device).map_err(unusable(method))?;
            masks(capture, config, |size| networks::sam2(net, &images, size), progress)
        }
    }
}

/// Tracks of dynamic points, by the tracking method.
#[cfg_attr(not(feature = "nets"), expect(unused_variables, reason = "only networks need it"))]
fn tracked(
    capture: &Capture,
    method: &Tracking,
    settings: &Settings,
    device: &NetworkDevice,
    progress: &dyn Progress,
) -> Result<Tracks, Error> {
    let clip = CaptureClip::new(capture, settings.dense.working_side_px);
    #[cfg(feature = "nets")]
    if let Tracking::Tapip3d(path) = method {
        let method = NetworkMethod::Tracker(Tracker::Tapip3d);
        let net = m4_nets::Tapip3d::load(path, &device.device).map_err(unusable(method))?;
        let config = &settings.enhance.tapip3d;
        let side = |n: usize| ((n as f64 * config.size).round() as usize).max(1);
        let (w, h) = net.published_size();
        let options = m4_nets::Tapip3dOptions {
            iterations: config.iterations,
            memory_bytes: config.memory_mb.saturating_mul(1_000_000),
            ..m4_nets::Tapip3dOptions::at((side(w), side(h)))
        };
        let grid = QueryGrid { every: config.every, spacing_px: config.spacing_px, most: config.most };
        return Ok(networks::tapip3d(&net, &options, &clip, &grid, progress).map_err(EnhanceError::from)?);
    }
    Ok(follow(&clip, &QueryGrid::chains(), progress).map_err(EnhanceError::from)?)
}

/// Why masks could not be refined or points not be followed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EnhanceError {
    /// Refinement failed.
    #[error(transparent)]
    Instances(#[from] InstanceError),
    /// Points could not be followed.
    #[error(transparent)]
    Tracks(#[from] TrackError),
}

impl EnhanceError {
    /// Returns the category of the failure.
    pub fn category(&self) -> Category {
        match self {
            Self::Instances(InstanceError::Cancelled { .. }) | Self::Tracks(TrackError::Cancelled { .. }) => {
                Category::Stopped
            }
            Self::Instances(InstanceError::Setting { .. }) | Self::Tracks(TrackError::Setting { .. }) => {
                Category::BadSettings
            }
            Self::Instances(_) | Self::Tracks(_) => Category::BadInput,
        }
    }
}
