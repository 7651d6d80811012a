//! The sizes of frames and of what is made of them.

use crate::tile_binning::gpu::TILE;

/// Entries of a bucket, and units of its cube.
pub(crate) const BUCKET: usize = 32;

/// The sizes that memory is allocated for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Splats.
    pub n: usize,
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// Entries of tiles at most; an image that wants more shows the background.
    pub entries: usize,
    /// For the gradient too.
    pub training: bool,
}

impl Size {
    pub(crate) fn across(&self) -> usize {
        self.width.div_ceil(TILE)
    }

    /// Tiles of the image.
    pub fn tiles(&self) -> usize {
        self.across() * self.height.div_ceil(TILE)
    }

    /// Pixels of the image.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Buckets at most.
    pub fn buckets(&self) -> usize {
        self.entries / BUCKET + self.tiles()
    }
}
