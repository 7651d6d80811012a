//! The part of an image that a band covers, and how tiles are cut from it.

use crate::bin::TILE;

/// Pixels a tile.
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
    pub(super) fn load(&self, plane: &[f32]) -> [f32; PIXELS] {
        let mut out = [0.0; PIXELS];
        for (y, row) in out.chunks_exact_mut(TILE).take(self.rows).enumerate() {
            let from = &plane[self.offset + y * self.width..];
            if self.columns == TILE {
                // of known length: one instruction in place of a call
                row.copy_from_slice(&from[..TILE]);
            } else {
                row[..self.columns].copy_from_slice(&from[..self.columns]);
            }
        }
        out
    }

    #[inline(always)]
    pub(super) fn store(&self, tile: &[f32; PIXELS], plane: &mut [f32]) {
        for (y, row) in tile.chunks_exact(TILE).take(self.rows).enumerate() {
            let to = &mut plane[self.offset + y * self.width..];
            if self.columns == TILE {
                to[..TILE].copy_from_slice(row);
            } else {
                to[..self.columns].copy_from_slice(&row[..self.columns]);
            }
        }
    }

    /// 1 inside the image, -1 (finished) outside.
    #[inline(always)]
    pub(super) fn fresh(&self) -> [f32; PIXELS] {
        if self.columns == TILE && self.rows == TILE {
            return [1.0; PIXELS];
        }
        let mut out = [-1.0; PIXELS];
        for row in out.chunks_exact_mut(TILE).take(self.rows) {
            row[..self.columns].fill(1.0);
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

/// The same, to read: a band's part of a frame and of its gradient.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BandGradient<'a> {
    pub(crate) rgb: [&'a [f32]; 3],
    pub(crate) transmittance: &'a [f32],
    pub(crate) depth: &'a [f32],
    pub(crate) d_rgb: [&'a [f32]; 3],
    /// Empty for none.
    pub(crate) d_alpha: &'a [f32],
    /// Empty for none.
    pub(crate) d_depth: &'a [f32],
}

/// Where band `index` lies.
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
    /// Tiles a row.
    pub(crate) fn tiles_x(&self) -> usize {
        self.width.div_ceil(TILE)
    }

    /// Every tile that has a pixel in the image: its index, the image coordinates of its first pixel
    /// and its window. Column by column: then a splat is needed again soon, while it is still in the
    /// first-level cache.
    pub(super) fn tiles(self) -> impl Iterator<Item = (usize, f32, f32, Window)> {
        let (tiles_x, tiles_y) = (self.tiles_x(), self.rows.div_ceil(TILE));
        (0..tiles_x * tiles_y).map(move |k| {
            let (x, y) = (k / tiles_y, k % tiles_y);
            let tile = y * tiles_x + x;
            let (x, y) = (x * TILE, y * TILE);
            let window = Window {
                offset: y * self.width + x,
                columns: (self.width - x).min(TILE),
                rows: (self.rows - y).min(TILE),
                width: self.width,
            };
            (tile, x as f32, (self.top + y) as f32, window)
        })
    }
}
