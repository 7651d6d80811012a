//! Errors of pretrained networks.

use super::Category;
#[cfg(feature = "nets")]
use super::WeightsError;
use crate::settings::{FrontendPart, Segmenter, Tracker};
use m4_core::advice::{CLASSICAL, FLOW_TRACKER, NO_SEGMENTER};
use std::fmt;

/// A method that needs a pretrained network; printed as its kind and its name, such as
/// `front end raft`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum NetworkMethod {
    /// A part of the front end.
    FrontEnd(FrontendPart),
    /// A segmenter.
    Segmenter(Segmenter),
    /// A point tracker.
    Tracker(Tracker),
}

impl NetworkMethod {
    /// Returns what works without a network.
    fn without(self) -> &'static str {
        match self {
            Self::FrontEnd(_) => CLASSICAL,
            Self::Segmenter(_) => NO_SEGMENTER,
            Self::Tracker(_) => FLOW_TRACKER,
        }
    }
}

impl fmt::Display for NetworkMethod {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FrontEnd(part) => write!(f, "front end {}", part.name()),
            Self::Segmenter(segmenter) => write!(f, "segmenter {}", segmenter.name()),
            Self::Tracker(tracker) => write!(f, "tracker {}", tracker.name()),
        }
    }
}

/// Why a network could not be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The program was built without networks.
    #[error(
        "this program was built without networks (the feature nets), which the {method} needs; {}",
        method.without()
    )]
    NotBuilt {
        /// The method.
        method: NetworkMethod,
    },
    /// The weights are missing.
    #[cfg(feature = "nets")]
    #[error("the {method} cannot be used: {source}; or {}", method.without())]
    Weights {
        /// The method.
        method: NetworkMethod,
        /// What is missing, and how to get it.
        source: WeightsError,
    },
    /// The weights are invalid.
    #[cfg(feature = "nets")]
    #[error("the {method} cannot be used: {source}; or {}", method.without())]
    Load {
        /// The method.
        method: NetworkMethod,
        /// The fault.
        source: Box<m4_nets::LoadError>,
    },
    /// The networks for depth from one image failed.
    #[cfg(feature = "nets")]
    #[error("{networks} estimated no depth of frame {frame}: {reason}")]
    Depth {
        /// Their names, joined by `+`.
        networks: String,
        /// The frame.
        frame: usize,
        /// What went wrong.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl NetworkError {
    /// Returns the category of the failure.
    pub fn category(&self) -> Category {
        match self {
            Self::NotBuilt { .. } => Category::NoDevice,
            #[cfg(feature = "nets")]
            Self::Weights { source, .. } => source.category(),
            #[cfg(feature = "nets")]
            Self::Load { .. } | Self::Depth { .. } => Category::NoDevice,
        }
    }
}
