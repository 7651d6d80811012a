//! A capture, enhanced as planned.

use super::plan::{Plan, Points, Things};
use super::{EnhanceConfig, EnhanceError, Follower, masks};
use crate::device::NetworkDevice;
use crate::{Error, Settings};
use m4_scene::{Capture, Progress};
use m4_slam::dense::{FlowSource, InverseSearch, TrackConfig};
use m4_slam::instances::InstanceReport;
use m4_slam::tracks3d::{CaptureClip, FlowTracker, QueryGrid, Tracker3d};

/// Refines masks, then follows points in them; gives what was found of things where anybody followed them.
///
/// # Errors
///
/// [`Error`] where a network cannot be loaded or fails, the capture says nothing of what moves, or `progress` says to stop.
pub(crate) fn apply(
    mut capture: Capture,
    plan: &Plan,
    settings: &Settings,
    device: &NetworkDevice,
    progress: &dyn Progress,
) -> Result<(Capture, Option<InstanceReport>), Error> {
    let config = &settings.enhance;
    let flow = InverseSearch {
        config: settings.dense.flow.clone(),
    };
    let mut report = None;
    if let Some((refined, found)) = things(&capture, &plan.things, config, &flow, device, progress)? {
        capture = refined;
        report = Some(found);
    }
    let tracks = &settings.dense.tracks;
    if let Some(tracker) = tracker(&plan.points, settings, &flow, device)? {
        let clip = CaptureClip::new(&capture, settings.dense.working_side_px);
        let followed = tracker.follow_grid(&clip, &grid(&plan.points, config, tracks), progress);
        let found = followed.map_err(EnhanceError::from)?.tracks;
        capture.tracks = (found.count() > 0).then_some(found);
    }
    Ok((capture, report))
}

#[cfg_attr(not(feature = "nets"), expect(unused_variables, reason = "only networks need it"))]
fn things(
    capture: &Capture,
    who: &Things,
    config: &EnhanceConfig,
    flow: &dyn FlowSource,
    device: &NetworkDevice,
    progress: &dyn Progress,
) -> Result<Option<(Capture, InstanceReport)>, Error> {
    match who {
        Things::Nobody => Ok(None),
        Things::Flow(pictures) => {
            let follower = Follower::load(*pictures, config.follow.clone())?;
            let found = masks(
                capture.clone(),
                &config.masks,
                &follower.segmenter(),
                Some(flow),
                progress,
            )?;
            Ok(Some(found))
        }
        #[cfg(feature = "nets")]
        Things::Sam2(path) => {
            let net = m4_nets::Sam2::load(path, &device.device).map_err(|source| Error::SegmenterLoad {
                segmenter: crate::geometry::Segmenter::Sam2.name(),
                source: Box::new(source),
            })?;
            let follower = super::Sam2Follower::new(net);
            let found = masks(capture.clone(), &config.masks, &follower, Some(flow), progress)?;
            Ok(Some(found))
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
        Points::Flow if !settings.dense.tracks.enabled => Ok(None),
        Points::Flow => Ok(Some(Box::new(FlowTracker {
            flow,
            config: settings.dense.tracks.clone(),
        }))),
        #[cfg(feature = "nets")]
        Points::Tapip3d(path) => {
            let net = m4_nets::Tapip3d::load(path, &device.device).map_err(|source| Error::TrackerLoad {
                tracker: super::Tracker::Tapip3d.name(),
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
fn grid(who: &Points, config: &EnhanceConfig, tracks: &TrackConfig) -> QueryGrid {
    let chains = QueryGrid {
        every: tracks.every,
        spacing_px: tracks.spacing_px,
        most: tracks.most,
        ..QueryGrid::default()
    };
    match who {
        #[cfg(feature = "nets")]
        Points::Tapip3d(_) => QueryGrid {
            every: config.tapip3d.every,
            spacing_px: config.tapip3d.spacing_px,
            most: config.tapip3d.most,
            ..chains
        },
        _ => chains,
    }
}
