//! The methods of the stage, what its parts share, and the way from a video to a capture on disk.

use super::clip::{Between, Clip};
use super::frontend::{self, Cameras};
use super::segmenter::{self, Resolved, Segmenter};
use super::{GeometryOptions, classical};
use crate::device::{DeviceChoice, NetworkDevice};
use crate::enhance::{self, Before};
use crate::record::GeometrySummary;
use crate::steps::Steps;
use crate::{Error, Observer, Settings};
use m4_core::Capture;
use std::path::Path;

/// The methods that the options come to: which weights are installed, and the device of networks.
pub(super) struct Methods {
    pub frontend: frontend::Plan,
    /// Sharpens the masks of the classical front end.
    pub segmenter: Resolved,
    /// What is done to the capture afterwards.
    pub enhance: enhance::Plan,
    pub device: NetworkDevice,
}

impl Methods {
    /// Resolves `options`.
    ///
    /// # Errors
    ///
    /// [`Error`]: weights are missing, the build has no networks, or the GPU does not start.
    pub fn resolve(options: &GeometryOptions, device: DeviceChoice) -> Result<Self, Error> {
        let frontend = frontend::plan(&options.frontend, device)?;
        let (asked, before) = match frontend.cameras {
            // Masks are made of its map of motion afterwards.
            Cameras::Megasam => (Segmenter::None, Before::Motion),
            Cameras::Corners => (options.segmenter, Before::Classical),
        };
        let segmenter = segmenter::resolve(asked)?;
        // Masks that the user gave stay.
        let refined = if options.masks.is_some() { Segmenter::None } else { options.segmenter };
        let enhance = enhance::Plan::of(refined, options.tracker, before)?;
        let device = if frontend.used.is_empty() && !enhance.has_network() {
            // A GPU that is not needed is not started, and does not count as a difference between results.
            NetworkDevice::processor()
        } else {
            device.for_networks()?
        };
        Ok(Self { frontend, segmenter, enhance, device })
    }
}

/// What all parts of the stage use.
#[derive(Clone, Copy)]
pub(super) struct Context<'a> {
    pub settings: &'a Settings,
    pub methods: &'a Methods,
    pub steps: &'a Steps<'a>,
}

impl<'a> Context<'a> {
    /// Receives progress and warnings, and says when to stop.
    pub fn observer(&self) -> &'a dyn Observer {
        self.steps.observer()
    }
}

/// Reads the clip, finds its geometry, refines masks and tracks points as planned, and writes the capture into `folder`.
///
/// # Errors
///
/// [`Error`]: the clip cannot be read, nothing can be reconstructed, the folder cannot be written, or the user stops.
pub(super) fn compute(input: &Path, folder: &Path, context: &Context<'_>) -> Result<GeometrySummary, Error> {
    let observer = context.observer();
    let between = Between::of(context.settings, &context.methods.frontend);
    let clip = Clip::read(input, between, context)?;
    let (capture, mut found) = reconstruct(clip, context)?;
    let capture = between.keep(capture, observer)?;
    found.frames = capture.frames.len();
    let plan = &context.methods.enhance;
    let (capture, report) = enhance::apply(capture, plan, context.settings, &context.methods.device, context.steps)?;
    enhance::write(folder, &capture, report.as_ref(), observer)?;
    found.networks.extend(plan.used.iter().cloned());
    if report.is_some() {
        plan.segmenter().clone_into(&mut found.segmenter);
        found.moving_share = enhance::moving_share(&capture).unwrap_or(0.0);
    }
    if let Some(tracks) = &capture.tracks {
        found.moving_tracks = tracks.count();
    }
    Ok(found)
}

fn reconstruct(clip: Clip, context: &Context<'_>) -> Result<(Capture, GeometrySummary), Error> {
    #[cfg(feature = "nets")]
    if context.methods.frontend.cameras == Cameras::Megasam {
        return super::megasam::compute(clip, context);
    }
    classical::compute(clip, context)
}
