//! The object tracker without a video network: propagates masks along flow.

use crate::Error;
use crate::geometry::{self, Segmenter};
use m4_geometry::classical::dense::{self, FlowSource, InverseSearch};
use m4_geometry::masks::FlowFollower;

/// Classical flow, and a segmenter of single images or none.
pub struct Follower {
    pictures: Option<Box<dyn dense::Segmenter>>,
    weights_hash: Option<String>,
}

impl Follower {
    /// With the segmenter that is asked for; its weights are looked for and loaded.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the build has no networks, or the weights are missing or cannot be used.
    pub fn load(pictures: Segmenter) -> Result<Self, Error> {
        let resolved = geometry::resolve_segmenter(pictures)?;
        Ok(Self {
            pictures: resolved.load()?,
            weights_hash: resolved.weights_hash().map(str::to_owned),
        })
    }

    /// What follows things.
    #[must_use]
    pub fn segmenter(&self) -> FlowFollower<'_> {
        FlowFollower::new(&InverseSearch, self.pictures.as_deref())
    }

    /// The source of flow, to check maps of motion with.
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
