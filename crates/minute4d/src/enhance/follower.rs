//! The object tracker without a video network: propagates masks along flow.

use crate::Error;
use crate::geometry::{self, Segmenter};
use m4_geometry::classical::dense::{self, FlowSource, InverseSearch};
use m4_geometry::masks::FlowFollower;

/// Classical flow, and a segmenter of single images or none.
pub struct Follower {
    segmenter: Option<Box<dyn dense::Segmenter>>,
    weights_hash: Option<String>,
}

impl Follower {
    /// Loads the weights of the requested segmenter.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the build has no networks, or the weights are missing or cannot be used.
    pub fn load(segmenter: Segmenter) -> Result<Self, Error> {
        let resolved = geometry::resolve_segmenter(segmenter)?;
        Ok(Self {
            segmenter: resolved.load()?,
            weights_hash: resolved.weights_hash().map(str::to_owned),
        })
    }

    /// Returns the segmenter that propagates masks along flow.
    #[must_use]
    pub fn segmenter(&self) -> FlowFollower<'_> {
        FlowFollower::new(&InverseSearch, self.segmenter.as_deref())
    }

    /// Returns the source of flow, which also checks motion maps.
    #[must_use]
    pub fn flow(&self) -> &dyn FlowSource {
        &InverseSearch
    }

    /// BLAKE3 of the weights, for records.
    #[must_use]
    pub fn weights_hash(&self) -> Option<&str> {
        self.weights_hash.as_deref()
    }
}
