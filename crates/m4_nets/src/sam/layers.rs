//! Layers that the parts share.

use burn_core::tensor::activation::softmax;
use burn_core::tensor::{Device, Tensor};
use burn_nn::{LayerNorm, LayerNormConfig};

/// A layer normalisation over the `width` channels of each pixel that waits for its weights (epsilon 1e-6).
pub fn channel_norm(width: usize, device: &Device) -> LayerNorm {
    LayerNormConfig::new(width).with_epsilon(1e-6).init(device)
}

/// `norm` over the channels of `x` `[n, c, h, w]`.
pub fn over_channels(norm: &LayerNorm, x: Tensor<4>) -> Tensor<4> {
    norm.forward(x.permute([0, 2, 3, 1])).permute([0, 3, 1, 2])
}

/// `softmax(q k^T / sqrt(c) + bias) v` of every head, `[n, heads, l, c]`; `bias` is `[1, heads, l, l]`.
pub fn heads(q: Tensor<4>, k: Tensor<4>, v: Tensor<4>, bias: Option<Tensor<4>>) -> Tensor<4> {
    let [_, _, _, c] = q.dims();
    let scores = q.mul_scalar(1.0 / (c as f32).sqrt()).matmul(k.swap_dims(2, 3));
    let scores = match bias {
        Some(bias) => scores + bias,
        None => scores,
    };
    softmax(scores, 3).matmul(v)
}
