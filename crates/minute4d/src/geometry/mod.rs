//! Turns a video into a capture: poses, focal length, depth, masks of what moves.
//!
//! ```text
//! Plan      methods (frontend, segmenter, enhance) by the weights that are installed
//! compute   video and what the user provides (given) -> clip -> reconstruction -> enhance -> capture
//! footage       frames -> those of one shot, without blank and repeated ones, bars, overlays, flicker
//! classical     frames --sparse--> cameras, tracks, points --dense--> depth, masks --> capture
//!                            ^                                          |    '-> confidence
//!                            '---- once more without masked tracks -----'
//! megasam       frames --tracking network--> cameras --optical flow--> consistent depth --> capture
//! ```
//!
//! These steps are kept ([`crate::cache`]): optical flow of each pair of frames, depth from
//! networks of each frame, the reconstruction of cameras, and dense depth; the last two again for a
//! second pass.

mod classical;
mod clip;
mod footage;
mod frontend;
mod given;
mod lens;
#[cfg(feature = "nets")]
mod megasam;
mod summary;

pub use m4_geometry::classical::confidence::{Confidence, Focal, Grade};
pub use m4_geometry::inspect::Footage;
pub use summary::GeometrySummary;

use crate::cache::Steps;
use crate::device::{DeviceChoice, NetworkDevice};
use crate::enhance::{self, Before};
use crate::networks::{Resolved, UsedNetwork, resolve_segmenter};
use crate::settings::{EnhanceConfig, GeometryOptions, Segmenter, Tracker};
use crate::{Error, Settings};
use clip::{Between, Clip};
use given::Sources;
use m4_core::{Capture, Progress};
use m4_geometry::masks::InstanceReport;
use serde::Serialize;
use std::path::Path;

/// The settings of a reconstruction and the methods that they come to: which weights are installed,
/// and the device of networks.
#[derive(Debug)]
pub struct Plan {
    settings: Settings,
    frontend: frontend::Plan,
    /// Sharpens the masks of the classical front end.
    segmenter: Resolved,
    /// What is done to the capture afterwards.
    enhance: enhance::Plan,
    device: NetworkDevice,
}

impl Plan {
    /// Resolves the methods that `settings` ask for.
    ///
    /// # Errors
    ///
    /// [`Error`]: weights are missing, the build has no networks, or the GPU does not start.
    pub fn new(settings: &Settings, device: DeviceChoice) -> Result<Self, Error> {
        let mut settings = settings.clone();
        // flow tracks are computed with the depth, unless another method tracks points afterwards
        settings.dense.tracks &=
            !matches!(settings.geometry.tracker, Tracker::None | Tracker::Tapip3d);
        let options = &settings.geometry;
        let frontend = frontend::plan(&options.frontend, device)?;
        // Masks are made of MegaSaM's map of motion afterwards.
        let (asked, before) = match frontend.is_megasam() {
            true => (Segmenter::None, Before::Motion),
            false => (options.segmenter, Before::Classical),
        };
        let segmenter = resolve_segmenter(asked)?;
        // Masks that the user gave stay.
        let refined = if options.masks.is_some() {
            Segmenter::None
        } else {
            options.segmenter
        };
        let enhance = enhance::Plan::of(refined, options.tracker, before)?;
        let device = if frontend.used.is_empty() && !enhance.has_network() {
            // A GPU that is not needed is not started, and does not count as a difference between
            // results.
            NetworkDevice::processor()
        } else {
            device.for_networks()?
        };
        Ok(Self {
            settings,
            frontend,
            segmenter,
            enhance,
            device,
        })
    }

    /// What the result depends on besides the frames.
    ///
    /// # Errors
    ///
    /// [`Error`] with the file of the user's that is missing or cannot be read.
    pub fn dependencies(&self) -> Result<Dependencies<'_>, Error> {
        let Self {
            settings,
            frontend,
            segmenter,
            enhance,
            device,
        } = self;
        Ok(Dependencies {
            video: &settings.video,
            sparse: &settings.sparse,
            dense: &settings.dense,
            seed: settings.sparse.seed,
            geometry: &settings.geometry,
            frontend: frontend.frontend.to_string(),
            weights: frontend.hashes(),
            megasam: (frontend.is_megasam()).then_some(&settings.megasam),
            device: device.name(),
            segmenter: segmenter.name(),
            segmenter_weights: segmenter.weights_hash(),
            enhance: (!enhance.nothing()).then_some((&settings.enhance, enhance.used.as_slice())),
            given: Sources::of(&settings.geometry)?,
        })
    }
}

/// A capture from a video.
#[derive(Debug)]
pub struct Reconstruction {
    /// Images, cameras, depth, masks, tracks.
    pub capture: Capture,
    /// What was measured, and how far it can be trusted.
    pub summary: GeometrySummary,
    /// The objects, where a method tracked them.
    pub objects: Option<InstanceReport>,
}

/// Everything besides the frames that a reconstruction depends on; the same dependencies and frames
/// give the same bits.
#[derive(Debug, Serialize)]
pub struct Dependencies<'a> {
    video: &'a m4_io::video::VideoOptions,
    sparse: &'a m4_geometry::classical::sparse::SparseConfig,
    dense: &'a m4_geometry::classical::dense::DenseConfig,
    /// Of random samples.
    seed: u64,
    /// The requested value.
    geometry: &'a GeometryOptions,
    /// What that came to: the front end's name, and the hashes of its weights.
    frontend: String,
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

/// What all parts of the stage use.
#[derive(Clone, Copy)]
struct Context<'a> {
    plan: &'a Plan,
    steps: Steps<'a>,
}

impl<'a> Context<'a> {
    /// Receives progress and warnings, and says when to stop.
    fn observer(&self) -> &'a dyn Progress {
        self.steps.observer()
    }

    fn settings(&self) -> &'a Settings {
        &self.plan.settings
    }
}

/// Reads the clip `input`, finds its geometry (Minute4D Eq. 3), refines masks and tracks points as
/// planned.
///
/// # Errors
///
/// [`Error`]: the clip cannot be read, nothing can be reconstructed, or a stop was requested.
pub fn compute(input: &Path, plan: &Plan, steps: Steps<'_>) -> Result<Reconstruction, Error> {
    let observer = steps.observer();
    for note in &plan.frontend.notes {
        observer.warn(note);
    }
    let context = Context { plan, steps };
    let between = Between::of(&plan.settings, &plan.frontend);
    let mut clip = Clip::read(input, between, &context)?;
    let footage = clip.footage.take();
    let (capture, mut summary) = match plan.frontend.is_megasam() {
        #[cfg(feature = "nets")]
        true => megasam::compute(clip, &context)?,
        _ => classical::compute(clip, &context)?,
    };
    let capture = between.keep(capture, &mut summary.objects, observer)?;
    let capture = clip::with_sigmas(capture, &summary.objects);
    summary.frames = capture.frames.len();
    summary.footage = footage;
    let enhance = &plan.enhance;
    let (capture, objects) = enhance::apply(capture, enhance, &plan.settings, &plan.device, steps)?;
    summary.networks.extend(enhance.used.iter().cloned());
    if objects.is_some() {
        enhance.segmenter().clone_into(&mut summary.segmenter);
        summary.moving_share = enhance::moving_share(&capture).unwrap_or(0.0);
    }
    if let Some(tracks) = &capture.tracks {
        summary.moving_tracks = tracks.count();
    }
    Ok(Reconstruction {
        capture,
        summary,
        objects,
    })
}
