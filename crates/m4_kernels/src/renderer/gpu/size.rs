//! The sizes of frames and of what is made of them.

use crate::tile_binning::gpu::TILE;

/// Entries of a bucket, and units of its cube.
pub(crate) const BUCKET: usize = 32;

/// Entries of tiles that memory is first made for: this many a splat, and at least as many as
/// [`LEAST_ENTRIES`]. Of a video most splats are missing at an instant; the first frame says how
/// many entries it takes, and is drawn again.
const FIRST_ENTRIES: usize = 1;
const LEAST_ENTRIES: usize = 1 << 16;

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
    /// Entries of tile lists that memory is first made for; a trainer and a renderer make more
    /// where a frame has more.
    pub fn first_entries(splats: usize) -> usize {
        (FIRST_ENTRIES * splats).max(LEAST_ENTRIES)
    }

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
