//! Memory in which a segment of the loss is computed.

use crate::simd::LANES;
use fearless_simd::{Simd, f32x16, prelude::*};

/// Rows and columns per block.
pub(super) const BLOCK: usize = LANES;
/// Rows that are kept: from the gradient's first to the last that the moments need.
pub(super) const RING: usize = 2 * BLOCK;
/// Columns that are kept of what is blurred along the rows: three blocks, and one for a power of
/// two. So they stay in the first-level cache.
pub(super) const SPAN: usize = 4 * BLOCK;

/// Sixteen columns of a row, or sixteen rows of a column: a cache line.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(64))]
pub(super) struct Line([f32; LANES]);

impl Line {
    #[inline(always)]
    pub(super) fn get<S: Simd>(&self, s: S) -> f32x16<S> {
        f32x16::from_slice(s, &self.0)
    }

    #[inline(always)]
    pub(super) fn set<S: Simd>(&mut self, value: f32x16<S>) {
        value.store_slice(&mut self.0);
    }
}

/// Some columns of a block of rows of `N` quantities, turned.
pub(super) type Turned<const N: usize, const COLUMNS: usize> = [[Line; COLUMNS]; N];

/// Memory of a segment, kept from frame to frame. The space past the ends of the rows is never
/// written and stays 0.
#[derive(Debug, Clone)]
pub(super) struct Buffers {
    pub(super) width: usize,
    /// A row of the target.
    pub(super) row: Vec<f32>,
    /// Image and target, `[2][RING][stride]`.
    pub(super) images: Vec<Line>,
    /// Blurred down the columns.
    pub(super) moments: Turned<4, SPAN>,
    /// Of one block: blurred along the rows too.
    pub(super) blurred: Turned<4, BLOCK>,
    /// Derivatives with respect to mean, square (twice that) and product.
    pub(super) slopes: Turned<3, SPAN>,
    /// The same blurred along the rows, `[3][RING][stride]`.
    pub(super) pulls: Vec<Line>,
}

impl Default for Buffers {
    fn default() -> Self {
        let zero = Line::default();
        Self {
            width: 0,
            row: Vec::new(),
            images: Vec::new(),
            moments: [[zero; SPAN]; 4],
            blurred: [[zero; BLOCK]; 4],
            slopes: [[zero; SPAN]; 3],
            pulls: Vec::new(),
        }
    }
}

impl Buffers {
    /// Makes room for rows of another length.
    pub(super) fn fit(&mut self, width: usize, blocks: usize, stride: usize) {
        if self.width == width && !self.images.is_empty() {
            return;
        }
        self.width = width;
        self.row.clear();
        self.row.resize(blocks * BLOCK, 0.0);
        for (buffer, rows) in [(&mut self.images, 2 * RING), (&mut self.pulls, 3 * RING)] {
            buffer.clear();
            buffer.resize(rows * stride, Line::default());
        }
    }
}
