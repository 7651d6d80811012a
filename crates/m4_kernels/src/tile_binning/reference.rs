//! The definition of a tile list, by brute force.

use super::TILE;
use crate::ellipse::reference::{Ellipse, Hard, reach};
use m4_core::Real;

/// Columns and rows of tiles.
pub fn grid(width: usize, height: usize) -> (usize, usize) {
    (width.div_ceil(TILE), height.div_ceil(TILE))
}

/// The tiles, `(column, row)` in row order, in which the splat reaches a pixel of the image with
/// `alpha >= ALPHA_MIN`, whatever lies in front of it.
pub fn tiles<T: Real>(splat: &Ellipse<T>, width: usize, height: usize) -> Vec<(usize, usize)> {
    let (columns, rows) = grid(width, height);
    let mut out = Vec::new();
    for (column, row) in (0..columns * rows).map(|i| (i % columns, i / columns)) {
        let mut xs = column * TILE..((column + 1) * TILE).min(width);
        let ys = row * TILE..((row + 1) * TILE).min(height);
        if xs.any(|x| ys.clone().any(|y| reach::<T, Hard>(splat, x, y).is_some())) {
            out.push((column, row));
        }
    }
    out
}

/// Indices of `depths` near to far, ties in the order of the rows.
pub fn depth_order<T: Real>(depths: &[T]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..depths.len()).collect();
    order.sort_by(|&a, &b| {
        depths[a]
            .partial_cmp(&depths[b])
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    order
}
