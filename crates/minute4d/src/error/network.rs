//! Errors of the methods that need a pretrained network.

use super::{BUILD_FULL, Category};
use crate::enhance::Tracker;
use crate::geometry::{FrontendPart, Segmenter};
use std::fmt;

/// A method that needs a pretrained network; printed as its kind and its name, such as `front end raft`.
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
    /// Returns the option that works without a network.
    fn without(self) -> &'static str {
        match self {
            Self::FrontEnd(_) => "--frontend classical",
            Self::Segmenter(_) => "--segmenter none",
            Self::Tracker(_) => "--tracker flow",
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
        "this program was built without networks, which the {method} needs: `{BUILD_FULL}` builds it with them; \
         {} works without",
        method.without()
    )]
    NotBuilt {
        /// The method.
        method: NetworkMethod,
    },
    /// The weights are missing.
    #[cfg(feature = "nets")]
    #[error("the {method} cannot be used: {source}; {} works without", method.without())]
    Weights {
        /// The method.
        method: NetworkMethod,
        /// What is missing, and how to get it.
        source: crate::weights::WeightsError,
    },
    /// The weights are invalid.
    #[cfg(feature = "nets")]
    #[error("the {method} cannot be used: {source}; {} works without", method.without())]
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
    #[must_use]
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

#[cfg(test)]
mod tests {
    use super::{BUILD_FULL, FrontendPart, NetworkError, NetworkMethod, Segmenter, Tracker};
    use crate::{Category, Error};

    const METHODS: [(NetworkMethod, &str, &str); 3] = [
        (NetworkMethod::FrontEnd(FrontendPart::Raft), "front end raft", "--frontend classical"),
        (NetworkMethod::Segmenter(Segmenter::Sam2), "segmenter sam2", "--segmenter none"),
        (NetworkMethod::Tracker(Tracker::Tapip3d), "tracker tapip3d", "--tracker flow"),
    ];

    #[test]
    fn build_without_networks_names_method_command_and_alternative() {
        for (method, name, without) in METHODS {
            let error = Error::from(NetworkError::NotBuilt { method });
            let expected = format!(
                "this program was built without networks, which the {name} needs: `{BUILD_FULL}` builds it with them; \
                 {without} works without"
            );
            assert_eq!(error.to_string(), expected);
            assert_eq!(error.category(), Category::NoDevice);
        }
    }

    #[cfg(feature = "nets")]
    #[test]
    fn missing_weights_keep_their_message_their_category_and_their_cause() {
        use crate::weights::WeightsError;
        use std::error::Error as _;

        for (method, name, without) in METHODS {
            let source = WeightsError::NoFolder;
            let (message, category) = (source.to_string(), source.category());
            let error = Error::from(NetworkError::Weights { method, source });
            assert_eq!(error.to_string(), format!("the {name} cannot be used: {message}; {without} works without"));
            assert_eq!(error.category(), category);
            assert_eq!(error.source().map(ToString::to_string), Some(message));
        }
    }
}
