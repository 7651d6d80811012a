//! Enhances a capture by a plan.

#[cfg(feature = "nets")]
use super::masks;
use super::plan::{Plan, Segmentation, Tracking};
use super::{EnhanceConfig, EnhanceError};
use crate::device::NetworkDevice;
#[cfg(feature = "nets")]
use crate::error::{NetworkError, NetworkMethod};
use crate::record::plain_json;
use crate::steps::Steps;
use crate::{Error, Settings};
use m4_core::{Capture, Progress};
use m4_geometry::classical::dense::{FlowSource, InverseSearch};
use m4_geometry::masks::InstanceReport;
use m4_geometry::tracks::{CaptureClip, FlowTracker, QueryGrid, TrackConfig, Tracker3d};

/// Refines masks, then tracks points in them, each a step; returns the statistics of objects if a method tracked them.
///
/// # Errors
///
/// [`Error`] where a network cannot be loaded or fails, the capture says nothing of the dynamic part, or the observer says to stop.
pub(crate) fn apply(
    mut capture: Capture,
    plan: &Plan,
    settings: &Settings,
    device: &NetworkDevice,
    steps: &Steps<'_>,
) -> Result<(Capture, Option<InstanceReport>), Error> {
    let config = &settings.enhance;
    let flow = InverseSearch;
    let mut report = None;
    if plan.segmentation != Segmentation::Unchanged {
        // The report as text, the form in which it is written in the end: its variants are distinguished by names.
        let (frames, text): (Vec<_>, String) = steps.keep("masks", |progress| {
            let (refined, report) = segmented(&capture, &plan.segmentation, config, &flow, device, progress)?;
            let frames = refined.frames.into_iter().map(|frame| (frame.mask, frame.instances));
            Ok::<_, Error>((frames.collect(), plain_json(&report)?.to_string()))
        })?;
        for (frame, (mask, ids)) in capture.frames.iter_mut().zip(frames) {
            (frame.mask, frame.instances) = (mask, ids);
        }
        let read = serde_json::from_str(&text).map_err(|e| Error::Internal { what: e.to_string() })?;
        report = Some(read);
    }
    if let Some(tracker) = tracker(&plan.tracking, settings, &flow, device)? {
        let clip = CaptureClip::new(&capture, settings.dense.working_side_px);
        let found = steps.keep("tracks", |progress| {
            let followed = tracker.follow_grid(&clip, &grid(&plan.tracking, config), progress);
            followed.map(|found| found.tracks).map_err(EnhanceError::from)
        })?;
        capture.tracks = (found.count() > 0).then_some(found);
    }
    Ok((capture, report))
}

/// Refines masks with the method that tracks objects; unchanged without one.
#[cfg_attr(not(feature = "nets"), expect(unused_variables, reason = "only networks need it"))]
fn segmented(
    capture: &Capture,
    method: &Segmentation,
    config: &EnhanceConfig,
    flow: &dyn FlowSource,
    device: &NetworkDevice,
    progress: &dyn Progress,
) -> Result<(Capture, InstanceReport), Error> {
    match method {
        Segmentation::Unchanged => Err(EnhanceError::NothingToDo.into()),
        #[cfg(feature = "nets")]
        Segmentation::Mobilesam => {
            let follower = super::Follower::load(crate::geometry::Segmenter::Mobilesam)?;
            let segmenter = follower.segmenter();
            masks(capture.clone(), &config.masks, &segmenter, Some(flow), progress)
        }
        #[cfg(feature = "nets")]
        Segmentation::Sam2(path) => {
            let net = m4_nets::Sam2::load(path, &device.device).map_err(|source| NetworkError::Load {
                method: NetworkMethod::Segmenter(crate::geometry::Segmenter::Sam2),
                source: Box::new(source),
            })?;
            let follower = super::Sam2Follower::new(net);
            masks(capture.clone(), &config.masks, &follower, Some(flow), progress)
        }
    }
}

#[cfg_attr(not(feature = "nets"), expect(unused_variables, reason = "only networks need it"))]
fn tracker<'a>(
    method: &Tracking,
    settings: &Settings,
    flow: &'a InverseSearch,
    device: &NetworkDevice,
) -> Result<Option<Box<dyn Tracker3d + 'a>>, Error> {
    match method {
        Tracking::Unchanged => Ok(None),
        Tracking::Flow if !settings.dense.tracks => Ok(None),
        Tracking::Flow => Ok(Some(Box::new(FlowTracker {
            flow,
            config: TrackConfig::default(),
        }))),
        #[cfg(feature = "nets")]
        Tracking::Tapip3d(path) => {
            let net = m4_nets::Tapip3d::load(path, &device.device).map_err(|source| NetworkError::Load {
                method: NetworkMethod::Tracker(super::Tracker::Tapip3d),
                source: Box::new(source),
            })?;
            let config = &settings.enhance.tapip3d;
            let side = |n: usize| ((n as f64 * config.size).round() as usize).max(1);
            let (w, h) = net.published_size();
            let options = m4_nets::Tapip3dOptions {
                iterations: config.iterations,
                memory_bytes: config.memory_mb.saturating_mul(1_000_000),
                ..m4_nets::Tapip3dOptions::at((side(w), side(h)))
            };
            Ok(Some(Box::new(super::Tapip3dTracker::new(net, options))))
        }
    }
}

/// Where points start.
#[cfg_attr(not(feature = "nets"), expect(unused_variables, reason = "only networks need it"))]
fn grid(method: &Tracking, config: &EnhanceConfig) -> QueryGrid {
    match method {
        #[cfg(feature = "nets")]
        Tracking::Tapip3d(_) => QueryGrid {
            every: config.tapip3d.every,
            spacing_px: config.tapip3d.spacing_px,
            most: config.tapip3d.most,
        },
        _ => QueryGrid::chains(),
    }
}
