//! The learned positions, for images of another size than they were learned for.
//!
//! Bicubic (a = -0.75, no antialiasing), as PyTorch's `interpolate` does it with a scale factor instead of a size: DINOv2 asks for
//! `(h + 0.1) / 37`, so that rounding cannot lose a row, and the samples lie `37 / (h + 0.1)` apart, not `37 / h`. Depth changes by a
//! fifth without that tenth. `UniDepth` V2 was trained without it.

use super::GRID;
use crate::ops::{Kernels, tensor};
use burn_core::tensor::{DType, Tensor};

/// What is added to a number of rows or columns before it becomes a scale.
pub const OFFSET: f64 = 0.1;

/// Positions `[1, 1 + h w, c]` in 32 bits, out of those `[1, 1 + 37 * 37, c]` that were learned, with samples `37 / (h + offset)`
/// apart.
pub fn resized(learned: Tensor<3>, h: usize, w: usize, offset: f64) -> Tensor<3> {
    let learned = learned.cast(DType::F32);
    if (h, w) == (GRID, GRID) {
        return learned;
    }
    let device = learned.device();
    let [_, _, c] = learned.dims();
    let along = |to: usize| {
        let kernels = Kernels::cubic_by_step(GRID, to, GRID as f64 / (to as f64 + offset));
        tensor(kernels.matrix(GRID), [to, GRID], &device)
    };
    let class = learned.clone().narrow(1, 0, 1);
    let rows: Tensor<2> = learned.narrow(1, 1, GRID * GRID).reshape([GRID, GRID * c]);
    let rows: Tensor<3> = along(h).matmul(rows).reshape([h, GRID, c]);
    let columns: Tensor<3> = along(w).unsqueeze();
    let patches = columns.matmul(rows).reshape([1, h * w, c]);
    Tensor::cat(vec![class, patches], 1)
}
