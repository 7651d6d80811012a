//! The part of an image that a band covers, and its division into tiles.

use crate::tile_binning::{
    TILE,
    cpu::{BLOCK_COLUMNS, BLOCK_TILES, BLOCK_WIDTH},
};
use fearless_simd::{Simd, f32x16, prelude::*};

/// Pixels a tile: one vector.
pub(super) const PIXELS: usize = TILE * TILE;

/// Where a tile lies in a band's planes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    /// Of its first pixel in the band's planes.
    offset: usize,
    /// Columns and rows of it that lie in the image.
    columns: usize,
    rows: usize,
    /// Columns of the image.
    width: usize,
}

impl Window {
    #[inline(always)]
    fn whole(&self) -> bool {
        self.columns == TILE && self.rows == TILE
    }

    /// The tile's pixels, row by row; 0 outside the image.
    #[inline(always)]
    pub(super) fn load<S: Simd>(&self, s: S, plane: &[f32]) -> f32x16<S> {
        if self.whole() {
            let row = |y: usize| {
                fearless_simd::f32x4::from_slice(s, &plane[self.offset + y * self.width..][..TILE])
            };
            return row(0).combine(row(1)).combine(row(2).combine(row(3)));
        }
        let mut out = [0.0; PIXELS];
        for (y, row) in out.chunks_exact_mut(TILE).take(self.rows).enumerate() {
            row[..self.columns]
                .copy_from_slice(&plane[self.offset + y * self.width..][..self.columns]);
        }
        f32x16::from_slice(s, &out)
    }

    #[inline(always)]
    pub(super) fn store<S: Simd>(&self, tile: f32x16<S>, plane: &mut [f32]) {
        let tile: [f32; PIXELS] = tile.to_array();
        for (y, row) in tile.chunks_exact(TILE).take(self.rows).enumerate() {
            let to = &mut plane[self.offset + y * self.width..];
            if self.columns == TILE {
                // of known length: one instruction instead of a call
                to[..TILE].copy_from_slice(row);
            } else {
                to[..self.columns].copy_from_slice(&row[..self.columns]);
            }
        }
    }

    /// `inside` in the image, `outside` elsewhere.
    #[inline(always)]
    pub(super) fn fresh(&self, inside: f32, outside: f32) -> [f32; PIXELS] {
        if self.whole() {
            return [inside; PIXELS];
        }
        let mut out = [outside; PIXELS];
        for row in out.chunks_exact_mut(TILE).take(self.rows) {
            row[..self.columns].fill(inside);
        }
        out
    }
}

/// The planes of one band, `[rows][width]` each.
#[derive(Debug)]
pub(crate) struct BandPlanes<'a> {
    pub(crate) rgb: [&'a mut [f32]; 3],
    pub(crate) transmittance: &'a mut [f32],
    /// Empty unless depth is composited.
    pub(crate) depth: &'a mut [f32],
}

/// The same, to read: a band's part of a frame and of the gradient with respect to its colours.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BandGradient<'a> {
    pub(crate) rgb: [&'a [f32]; 3],
    pub(crate) transmittance: &'a [f32],
    pub(crate) d_rgb: [&'a [f32]; 3],
}

/// Where a band lies.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BandPlace {
    /// First pixel row.
    pub(crate) top: usize,
    /// Pixel rows in the image.
    pub(crate) rows: usize,
    /// Columns of the image.
    pub(crate) width: usize,
}

impl BandPlace {
    /// Blocks in the band.
    pub(crate) fn blocks(&self) -> usize {
        self.width.div_ceil(BLOCK_WIDTH)
    }

    /// First column and row of a tile in the image, pixels.
    #[inline(always)]
    pub(super) fn corner(&self, block: usize, tile: usize) -> (usize, usize) {
        let (x, y) = (tile % BLOCK_COLUMNS, tile / BLOCK_COLUMNS);
        (block * BLOCK_WIDTH + x * TILE, self.top + y * TILE)
    }

    /// Where a tile lies; none of it may be in the image.
    #[inline(always)]
    pub(super) fn window(&self, block: usize, tile: usize) -> Window {
        debug_assert!(tile < BLOCK_TILES);
        let (x, y) = self.corner(block, tile);
        let y = y - self.top;
        Window {
            offset: y * self.width + x,
            columns: self.width.saturating_sub(x).min(TILE),
            // none where no column is: what lies there need not be in the planes
            rows: if x < self.width {
                self.rows.saturating_sub(y).min(TILE)
            } else {
                0
            },
            width: self.width,
        }
    }
}
