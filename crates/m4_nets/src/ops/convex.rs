//! Convex upsampling (RAFT, section 3.3): each pixel a weighted mean of nine of the coarse ones.

use burn_core::tensor::Tensor;
use burn_core::tensor::activation::softmax;
use burn_core::tensor::ops::PadMode;

/// The 3 by 3 values around each pixel of `x` `[h, w, d]`, row by row: `[h, w, 9, d]`; 0 outside.
fn neighbours(x: Tensor<3>) -> Tensor<4> {
    let [h, w, _] = x.dims();
    let x = x.pad([(1, 1), (1, 1), (0, 0)], PadMode::Constant(0.0));
    let shifted = (0..9).map(|i| x.clone().narrow(0, i / 3, h).narrow(1, i % 3, w)).collect();
    Tensor::stack(shifted, 2)
}

/// Of `flow` `[h, w, 2]` (pixels of the map): the flow `[factor h, factor w, 2]` in pixels of the image, which has `factor`
/// times the sides. `weights` are `[9 factor factor, h, w]`: neighbour, then row and column within the pixel; their softmax over
/// the neighbours is what counts.
pub fn convex_upsample(flow: Tensor<3>, weights: Tensor<3>, factor: usize) -> Tensor<3> {
    let [h, w, _] = flow.dims();
    // [9, factor factor, h, w] -> [h, w, factor factor, 9]
    let weights = weights.reshape([9, factor * factor, h, w]).permute([2, 3, 1, 0]);
    softmax(weights, 3)
        .matmul(neighbours(flow.mul_scalar(factor as f32)))
        .reshape([h, w, factor, factor, 2])
        .permute([0, 2, 1, 3, 4])
        .reshape([h * factor, w * factor, 2])
}
