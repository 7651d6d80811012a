//! Layers that the parts share.

pub use crate::ops::zeros;

use crate::ops::Statistics;
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::activation::softmax;
use burn_core::tensor::module::conv2d;
use burn_core::tensor::ops::ConvOptions;
use burn_core::tensor::{Device, Tensor};
use burn_nn::{LayerNorm, LayerNormConfig};

/// A convolution and a batch normalisation after it, which is of the statistics of training: one convolution.
#[derive(Module, Debug)]
pub struct ConvBn {
    c: Kernel,
    bn: Statistics,
    stride: usize,
    groups: usize,
}

/// A kernel without bias.
#[derive(Module, Debug)]
pub struct Kernel {
    /// `[out, in / groups, k, k]`.
    weight: Param<Tensor<4>>,
}

impl ConvBn {
    /// Of `[from, to]` channels, with a kernel of `size` by `size`, padded by half of that.
    pub fn new([from, to]: [usize; 2], size: usize, stride: usize, device: &Device) -> Self {
        Self::grouped([from, to], size, stride, 1, device)
    }

    /// 3 by 3, each of `width` channels by itself.
    pub fn depthwise(width: usize, stride: usize, device: &Device) -> Self {
        Self::grouped([width, width], 3, stride, width, device)
    }

    fn grouped([from, to]: [usize; 2], size: usize, stride: usize, groups: usize, device: &Device) -> Self {
        Self {
            c: Kernel {
                weight: zeros([to, from / groups, size, size], device),
            },
            bn: Statistics::new(to, device),
            stride,
            groups,
        }
    }

    /// Of `[n, from, h, w]`: `[n, to, h / stride, w / stride]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let (kernel, bias) = self.bn.after(self.c.weight.val(), None);
        let [_, _, size, _] = kernel.dims();
        let pad = [size / 2, size / 2];
        let options = ConvOptions::new([self.stride, self.stride], pad, [1, 1], self.groups);
        conv2d(x, kernel, Some(bias), options)
    }
}

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
