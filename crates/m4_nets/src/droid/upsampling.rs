//! Disparities at the size of the image.

use burn_core::tensor::activation::softmax;
use burn_core::tensor::ops::PadMode;
use burn_core::tensor::{DType, Tensor};

/// Side of the block that a pixel of the grid becomes.
const BLOCK: usize = 8;

/// Each of the 8 x 8 pixels of a block as a mean of the nine pixels of `values` `[h, w]` around it (0 outside), weighted by the
/// softmax of its scores in `mask` `[1, 576, h, w]` (neighbour, row of the block, column of the block): `[8 h, 8 w]`.
pub fn convex(values: Tensor<2>, mask: Tensor<4>) -> Tensor<2> {
    let [h, w] = values.dims();
    let mask = softmax(mask.cast(DType::F32).reshape([9, BLOCK * BLOCK, h * w]), 0);
    let padded = values.pad([(1, 1), (1, 1)], PadMode::Constant(0.0));
    let around = (0..9).map(|k| padded.clone().slice([k / 3..k / 3 + h, k % 3..k % 3 + w]));
    let around = Tensor::stack::<3>(around.collect(), 0).reshape([9, 1, h * w]);
    (mask * around).sum_dim(0).reshape([BLOCK, BLOCK, h, w]).permute([2, 0, 3, 1]).reshape([BLOCK * h, BLOCK * w])
}
