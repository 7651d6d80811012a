//! Chooses the segmentation and tracking methods by the installed weights.

use super::Tracker;
use crate::Error;
use crate::error::{NetworkError, NetworkMethod};
use crate::geometry::{Segmenter, UsedNetwork};
#[cfg(feature = "nets")]
use crate::weights::{self, State, Store, WeightsError};
#[cfg(feature = "nets")]
use std::path::PathBuf;

/// Sizes of SAM 2.1, the best first.
#[cfg(feature = "nets")]
const SAM2: [&str; 4] = ["sam2.1-large", "sam2.1-base-plus", "sam2.1-small", "sam2.1-tiny"];
#[cfg(feature = "nets")]
const MOBILE_SAM: &str = "mobile-sam";
#[cfg(feature = "nets")]
const TAPIP3D: &str = "tapip3d";

/// The segmentation method.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Segmentation {
    /// Masks stay unchanged.
    Unchanged,
    /// Optical flow, with MobileSAM for single images.
    #[cfg(feature = "nets")]
    Mobilesam,
    /// SAM 2.1.
    #[cfg(feature = "nets")]
    Sam2(PathBuf),
}

/// The tracking method.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Tracking {
    /// Tracks stay unchanged.
    Unchanged,
    /// Chains of flow.
    Flow,
    /// TAPIP3D.
    #[cfg(feature = "nets")]
    Tapip3d(PathBuf),
}

/// The methods, whose weights were found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Plan {
    pub segmentation: Segmentation,
    pub tracking: Tracking,
    /// The networks.
    pub used: Vec<UsedNetwork>,
}

/// What has been done before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Before {
    /// Masks that a segmenter of single images sharpened, and chains of flow: only networks with a memory can add to them.
    Classical,
    /// A map of how likely each pixel moves, and no tracks.
    Motion,
}

impl Plan {
    /// Nothing is done.
    pub fn nothing(&self) -> bool {
        self.segmentation == Segmentation::Unchanged && self.tracking == Tracking::Unchanged
    }

    /// Whether a network is among them.
    pub fn has_network(&self) -> bool {
        !self.used.is_empty()
    }

    /// As records name the segmentation method.
    pub fn segmenter(&self) -> &'static str {
        match self.segmentation {
            Segmentation::Unchanged => Segmenter::None.name(),
            #[cfg(feature = "nets")]
            Segmentation::Mobilesam => Segmenter::Mobilesam.name(),
            #[cfg(feature = "nets")]
            Segmentation::Sam2(_) => Segmenter::Sam2.name(),
        }
    }

    /// As records name the tracking method.
    pub fn tracker(&self) -> &'static str {
        match self.tracking {
            Tracking::Unchanged => Tracker::None.name(),
            Tracking::Flow => Tracker::Flow.name(),
            #[cfg(feature = "nets")]
            Tracking::Tapip3d(_) => Tracker::Tapip3d.name(),
        }
    }

    /// Finds what is asked for.
    ///
    /// # Errors
    ///
    /// [`NetworkError::Weights`] if weights are missing, [`NetworkError::NotBuilt`] if the build has no networks.
    #[cfg(feature = "nets")]
    pub fn of(segmenter: Segmenter, tracker: Tracker, before: Before) -> Result<Self, Error> {
        let mut used = Vec::new();
        let sam2 = || SAM2.iter().find_map(|name| here(name));
        let found = match segmenter {
            Segmenter::Sam2 => Some(sam2().ok_or_else(|| NetworkError::Weights {
                method: NetworkMethod::Segmenter(Segmenter::Sam2),
                source: missing(SAM2[0]),
            })?),
            Segmenter::Auto => sam2(),
            Segmenter::None | Segmenter::Mobilesam => None,
        };
        let segmentation = match (found, segmenter, before) {
            (Some((entry, path)), ..) => {
                used.push(used_network(entry, &path)?);
                Segmentation::Sam2(path)
            }
            (None, Segmenter::Mobilesam | Segmenter::Auto, Before::Motion) => match here(MOBILE_SAM) {
                Some((entry, path)) => {
                    used.push(used_network(entry, &path)?);
                    Segmentation::Mobilesam
                }
                None if segmenter == Segmenter::Mobilesam => {
                    return Err(NetworkError::Weights {
                        method: NetworkMethod::Segmenter(segmenter),
                        source: missing(MOBILE_SAM),
                    }
                    .into());
                }
                None => Segmentation::Unchanged,
            },
            _ => Segmentation::Unchanged,
        };
        let tracking = match (tracker, before) {
            (Tracker::Tapip3d, _) => {
                let (entry, path) = here(TAPIP3D).ok_or_else(|| NetworkError::Weights {
                    method: NetworkMethod::Tracker(tracker),
                    source: missing(TAPIP3D),
                })?;
                used.push(used_network(entry, &path)?);
                Tracking::Tapip3d(path)
            }
            (Tracker::Auto | Tracker::Flow, Before::Motion) => Tracking::Flow,
            _ => Tracking::Unchanged,
        };
        Ok(Self { segmentation, tracking, used })
    }

    /// Finds what is asked for.
    ///
    /// # Errors
    ///
    /// [`NetworkError::NotBuilt`]: the build has no networks.
    #[cfg(not(feature = "nets"))]
    pub fn of(segmenter: Segmenter, tracker: Tracker, before: Before) -> Result<Self, Error> {
        if matches!(segmenter, Segmenter::Mobilesam | Segmenter::Sam2) {
            let method = NetworkMethod::Segmenter(segmenter);
            return Err(NetworkError::NotBuilt { method }.into());
        }
        let tracking = match (tracker, before) {
            (Tracker::Tapip3d, _) => {
                let method = NetworkMethod::Tracker(tracker);
                return Err(NetworkError::NotBuilt { method }.into());
            }
            (Tracker::Auto | Tracker::Flow, Before::Motion) => Tracking::Flow,
            _ => Tracking::Unchanged,
        };
        Ok(Self { segmentation: Segmentation::Unchanged, tracking, used: Vec::new() })
    }
}

#[cfg(feature = "nets")]
fn here(name: &str) -> Option<(&'static weights::Entry, PathBuf)> {
    let entry = weights::find(name).ok()?;
    match Store::of_user().ok()?.state(entry) {
        State::Stored(path) | State::InHub(path) => Some((entry, path)),
        State::Absent => None,
    }
}

/// Why the weights `name` are not here, and how to get them.
#[cfg(feature = "nets")]
fn missing(name: &str) -> WeightsError {
    let entry = match weights::find(name) {
        Ok(entry) => entry,
        Err(error) => return error,
    };
    let error = Store::of_user().and_then(|store| store.require(entry));
    error.err().unwrap_or(WeightsError::NoFolder)
}

#[cfg(feature = "nets")]
fn used_network(entry: &weights::Entry, path: &std::path::Path) -> Result<UsedNetwork, Error> {
    Ok(UsedNetwork {
        weights: entry.name.to_owned(),
        licence: entry.licence.to_owned(),
        commercial: entry.commercial,
        blake3: crate::hash::of_path(path)?,
    })
}
