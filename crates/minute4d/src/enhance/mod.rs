//! Better masks for a capture (Minute4D sec. 3.2): dynamic objects are separated, segmented and
//! tracked through the clip.
//!
//! ```text
//! capture (motion maps, or masks) --m4_geometry::masks, with an object tracker--> capture (masks, instances), report
//! ```
//!
//! [`apply`] also follows points in the new masks ([`m4_geometry::tracks`]); [`crate::geometry`]
//! calls it on what its front ends find.

mod masks;
#[cfg(feature = "nets")]
mod networks;
mod plan;

pub use masks::masks;
pub use masks::write;
pub use plan::{Before, Plan};

use crate::cache::Steps;
use crate::device::NetworkDevice;
#[cfg(feature = "nets")]
use crate::error::NetworkMethod;
use crate::json::plain_json;
#[cfg(feature = "nets")]
use crate::networks::{resolve_segmenter, unusable};
#[cfg(feature = "nets")]
use crate::settings::{Segmenter, Tracker};
use crate::{Error, Refusal, Settings};
use m4_core::{Capture, CompactIds, CompactMask, Progress, Tracks};
#[cfg(feature = "nets")]
use m4_geometry::masks::FlowFollower;
use m4_geometry::masks::InstanceReport;
use m4_geometry::tracks::{CaptureClip, QueryGrid, follow};
use plan::{Segmentation, Tracking};

/// Share of the pixels in masks; `None` without masks.
pub fn moving_share(capture: &Capture) -> Option<f64> {
    let masks = || {
        capture
            .frames
            .iter()
            .filter_map(|frame| frame.mask.as_ref())
    };
    let pixels: usize = masks().map(|mask| mask.size().0 * mask.size().1).sum();
    let n_dynamic: usize = masks().map(CompactMask::count).sum();
    (pixels > 0).then(|| n_dynamic as f64 / pixels as f64)
}

/// The refusal of a plan without a method, or none that is available.
pub fn nothing_to_do() -> Error {
    let message = "there is nothing to do: without a segmenter and without a tracker a capture stays as it is; choose one of them";
    Refusal::usage(message).into()
}

/// Refines masks, then tracks points in them, each a step; returns the statistics of objects if a
/// method tracked them.
pub fn apply(
    mut capture: Capture,
    plan: &Plan,
    settings: &Settings,
    device: &NetworkDevice,
    steps: Steps<'_>,
) -> Result<(Capture, Option<InstanceReport>), Error> {
    let mut report = None;
    if plan.segmentation != Segmentation::Unchanged {
        // The report as text, the form in which it is written in the end: its variants are
        // distinguished by names.
        let (frames, text): (Vec<_>, String) = steps.keep("masks", |progress| {
            let (frames, report) =
                segmented(&capture, &plan.segmentation, settings, device, progress)?;
            Ok::<_, Error>((frames, plain_json(&report)?.to_string()))
        })?;
        for (frame, (mask, ids)) in capture.frames.iter_mut().zip(frames) {
            (frame.mask, frame.instances) = (Some(mask), Some(ids));
        }
        report = Some(serde_json::from_str(&text).map_err(Error::internal)?);
    }
    let follows = match plan.tracking {
        Tracking::Unchanged => false,
        Tracking::Flow => settings.dense.tracks,
        Tracking::Tapip3d(_) => true,
    };
    if follows {
        let tracks = steps.keep("tracks", |progress| {
            tracked(&capture, &plan.tracking, settings, device, progress)
        })?;
        capture.tracks = (tracks.count() > 0).then_some(tracks);
    }
    Ok((capture, report))
}

/// Refined masks and numbers of objects, by the method that tracks objects.
#[cfg_attr(
    not(feature = "nets"),
    expect(unused_variables, reason = "only networks need it")
)]
fn segmented(
    capture: &Capture,
    method: &Segmentation,
    settings: &Settings,
    device: &NetworkDevice,
    progress: &dyn Progress,
) -> Result<(Vec<(CompactMask, CompactIds)>, InstanceReport), Error> {
    #[cfg(feature = "nets")]
    let (images, config): (Vec<_>, _) = (
        capture.frames.iter().map(|frame| &frame.rgb).collect(),
        &settings.enhance.masks,
    );
    match method {
        #[cfg(feature = "nets")]
        Segmentation::Mobilesam => {
            let segmenter = resolve_segmenter(Segmenter::Mobilesam)?.load()?;
            let outlines = segmenter
                .as_deref()
                .map(|segmenter| ("mobilesam+classical", segmenter));
            masks(
                capture,
                config,
                |size| Ok(Box::new(FlowFollower::new(&images, size, outlines))),
                progress,
            )
        }
        #[cfg(feature = "nets")]
        Segmentation::Sam2(path) => {
            let method = NetworkMethod::Segmenter(Segmenter::Sam2);
            let net = m4_nets::Sam2::load(path, &device.device).map_err(unusable(method))?;
            masks(
                capture,
                config,
                |size| networks::sam2(net, &images, size),
                progress,
            )
        }
        _ => Err(nothing_to_do()),
    }
}

/// Tracks of dynamic points, by the tracking method.
#[cfg_attr(
    not(feature = "nets"),
    expect(unused_variables, reason = "only networks need it")
)]
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
        let grid = QueryGrid {
            every: config.every,
            spacing_px: config.spacing_px,
            most: config.most,
        };
        return Ok(networks::tapip3d(&net, &options, &clip, &grid, progress)?);
    }
    Ok(follow(&clip, &QueryGrid::chains(), progress)?)
}
