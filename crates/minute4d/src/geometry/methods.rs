//! The methods of the stage and what its parts share.

use super::GeometryOptions;
use super::frontend::{self, Cameras};
use super::segmenter::{self, Resolved, Segmenter};
use crate::device::{DeviceChoice, NetworkDevice};
use crate::enhance::{self, Before};
use crate::steps::Steps;
use crate::{Error, Observer, Settings};

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
        let refined = if options.masks.is_some() {
            Segmenter::None
        } else {
            options.segmenter
        };
        let enhance = enhance::Plan::of(refined, options.tracker, before)?;
        let device = if frontend.used.is_empty() && !enhance.has_network() {
            // A GPU that is not needed is not started, and does not count as a difference between results.
            NetworkDevice::processor()
        } else {
            device.for_networks()?
        };
        Ok(Self {
            frontend,
            segmenter,
            enhance,
            device,
        })
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
