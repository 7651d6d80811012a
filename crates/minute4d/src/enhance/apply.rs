//! Enhances a capture by a plan.

use super::plan::{Plan, Points, Things};
use super::{EnhanceConfig, EnhanceError, Follower, masks};
use crate::device::NetworkDevice;
#[cfg(feature = "nets")]
use crate::error::{NetworkError, NetworkMethod};
use crate::record::plain_json;
use crate::steps::Steps;
use crate::{Error, Settings};
use m4_core::{Capture, CompactIds, CompactMask, Mask, Plane, Progress};
use m4_geometry::dense::{FlowSource, InverseSearch};
use m4_geometry::instances::InstanceReport;
use m4_geometry::tracks3d::{CaptureClip, FlowTracker, QueryGrid, TrackConfig, Tracker3d};

/// Refines masks, then follows points in them, each a step; returns the statistics of objects if a method tracked them.
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
    if plan.things != Things::Nobody {
        let work = |progress: &dyn Progress| things(&capture, &plan.things, config, &flow, device, progress);
        let found = kept_masks(steps, capture.frames.len(), work)?;
        for (frame, (mask, ids)) in capture.frames.iter_mut().zip(found.frames) {
            (frame.mask, frame.instances) = (mask, ids);
        }
        report = Some(found.report);
    }
    if let Some(tracker) = tracker(&plan.points, settings, &flow, device)? {
        let clip = CaptureClip::new(&capture, settings.dense.working_side_px);
        let found = steps.keep("tracks", |progress| {
            let followed = tracker.follow_grid(&clip, &grid(&plan.points, config), progress);
            followed.map(|found| found.tracks).map_err(EnhanceError::from)
        })?;
        capture.tracks = (found.count() > 0).then_some(found);
    }
    Ok((capture, report))
}

/// Masks and maps of things, a pair a frame, and what was found.
struct Masks {
    frames: Vec<(Option<CompactMask>, Option<CompactIds>)>,
    report: InstanceReport,
}

/// Name of the step that is stored last.
const MASKS: &str = "masks";

/// Masks from the finished steps, or as `work` makes them; they are steps then, one per frame.
fn kept_masks(
    steps: &Steps<'_>,
    frames: usize,
    work: impl Fn(&dyn Progress) -> Result<(Capture, InstanceReport), Error>,
) -> Result<Masks, Error> {
    let name = |i: usize| format!("{MASKS}-{i:05}");
    let load = |i: usize| -> Option<(Option<CompactMask>, Option<CompactIds>)> {
        let (mask, ids): (Option<Mask>, Option<Plane<u16>>) = steps.load(&name(i))?;
        Some((mask.map(CompactMask::from), ids.as_ref().map(CompactIds::from)))
    };
    let mut made = None;
    // As text, the form in which it is written in the end: its kinds are distinguished by names.
    let report: String = steps.keep(MASKS, |observer| {
        let (refined, report) = work(observer)?;
        let mut frames = Vec::with_capacity(refined.frames.len());
        for (i, frame) in refined.frames.into_iter().enumerate() {
            let planes = (
                frame.mask.as_ref().map(CompactMask::to_mask),
                frame.instances.as_ref().map(CompactIds::to_plane),
            );
            steps.store(&name(i), &planes);
            frames.push((frame.mask, frame.instances));
        }
        let text = plain_json(&report)?.to_string();
        made = Some(Masks { frames, report });
        Ok::<_, Error>(text)
    })?;
    if let Some(made) = made {
        return Ok(made);
    }
    let kept: Option<Vec<_>> = (0..frames).map(load).collect();
    match (kept, serde_json::from_str(&report)) {
        (Some(frames), Ok(report)) => Ok(Masks { frames, report }),
        _ => {
            let (refined, report) = work(steps.observer())?;
            let frames = refined.frames.into_iter().map(|frame| (frame.mask, frame.instances));
            Ok(Masks {
                frames: frames.collect(),
                report,
            })
        }
    }
}

/// Refines masks with the method that tracks objects; unchanged without one.
#[cfg_attr(not(feature = "nets"), expect(unused_variables, reason = "only networks need it"))]
fn things(
    capture: &Capture,
    who: &Things,
    config: &EnhanceConfig,
    flow: &dyn FlowSource,
    device: &NetworkDevice,
    progress: &dyn Progress,
) -> Result<(Capture, InstanceReport), Error> {
    match who {
        Things::Nobody => Err(EnhanceError::NothingToDo.into()),
        Things::Flow(pictures) => {
            let follower = Follower::load(*pictures)?;
            masks(
                capture.clone(),
                &config.masks,
                &follower.segmenter(),
                Some(flow),
                progress,
            )
        }
        #[cfg(feature = "nets")]
        Things::Sam2(path) => {
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
    who: &Points,
    settings: &Settings,
    flow: &'a InverseSearch,
    device: &NetworkDevice,
) -> Result<Option<Box<dyn Tracker3d + 'a>>, Error> {
    match who {
        Points::Nobody => Ok(None),
        Points::Flow if !settings.dense.tracks => Ok(None),
        Points::Flow => Ok(Some(Box::new(FlowTracker {
            flow,
            config: TrackConfig::default(),
        }))),
        #[cfg(feature = "nets")]
        Points::Tapip3d(path) => {
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
fn grid(who: &Points, config: &EnhanceConfig) -> QueryGrid {
    match who {
        #[cfg(feature = "nets")]
        Points::Tapip3d(_) => QueryGrid {
            every: config.tapip3d.every,
            spacing_px: config.tapip3d.spacing_px,
            most: config.tapip3d.most,
            ..QueryGrid::default()
        },
        _ => QueryGrid::chains(),
    }
}
