//! Operations that several layers share. What changed between versions of Burn is called from here.

mod attention;
mod convex;
mod convolution;
mod gates;
mod gelu;
mod imagenet;
mod lanes;
mod positions;
mod resample;
mod softmax;
mod statistics;

pub use attention::attend_heads;
pub use convex::convex_upsample;
pub use convolution::{convolve, convolve_edges};
pub use gates::{sigmoid, tanh};
pub use gelu::{gelu, gelu_by_tanh};
pub use imagenet::{IMAGENET_MEAN, IMAGENET_STD, planes};
pub use positions::sine_positions;
pub use resample::{Kernels, resampled};
pub use softmax::softmax_rows;
pub use statistics::Statistics;

use burn_core::module::Param;
use burn_core::tensor::activation::softmax;
use burn_core::tensor::module::layer_norm;
use burn_core::tensor::{DType, Device, Tensor, TensorData};
use burn_nn::conv::{Conv2d, Conv2dConfig};
use burn_nn::{Initializer, LayerNorm, LayerNormConfig, Linear, LinearConfig, PaddingConfig2d};

/// A tensor of `values` in the shape `shape`, row by row.
pub fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// A parameter that waits for its weights.
pub fn zeros<const D: usize>(shape: [usize; D], device: &Device) -> Param<Tensor<D>> {
    Initializer::Zeros.init(shape, device)
}

/// A square convolution of `[from, to]` channels that waits for its weights, padded by half its kernel.
pub fn conv(channels: [usize; 2], kernel: usize, stride: usize, bias: bool, device: &Device) -> Conv2d {
    let pad = kernel / 2;
    Conv2dConfig::new(channels, [kernel, kernel])
        .with_stride([stride, stride])
        .with_padding(PaddingConfig2d::Explicit(pad, pad, pad, pad))
        .with_bias(bias)
        .with_initializer(Initializer::Zeros)
        .init(device)
}

/// `conv` with other weights `[out, in, h, w]` of its kernel's size.
pub fn with_weights(conv: Conv2d, weight: Tensor<4>, bias: Option<Tensor<1>>) -> Conv2d {
    Conv2d { weight: Param::from_tensor(weight), bias: bias.map(Param::from_tensor), ..conv }
}

/// A linear layer that waits for its weights.
pub fn linear(from: usize, to: usize, bias: bool, device: &Device) -> Linear {
    LinearConfig::new(from, to).with_bias(bias).with_initializer(Initializer::Zeros).init(device)
}

/// A layer normalisation over `width` channels that waits for its weights.
pub fn norm(width: usize, device: &Device) -> LayerNorm {
    LayerNormConfig::new(width).init(device)
}

/// Each channel of each image of `x` `[n, c, h, w]` less its mean, divided by its standard deviation (over the `h * w`
/// pixels, epsilon 1e-5): instance normalisation without weights. Sums are made in 32 bits, whatever `x` is in.
pub fn instance_norm(x: Tensor<4>) -> Tensor<4> {
    let [n, c, h, w] = x.dims();
    let dtype = x.dtype();
    let ones = Tensor::ones([h * w], (&x.device(), DType::F32));
    let x = x.cast(DType::F32).reshape([n, c, h * w]);
    layer_norm(x, ones, None, 1e-5).reshape([n, c, h, w]).cast(dtype)
}

/// Rows of queries that one step of [`attend`] takes.
const QUERY_ROWS: usize = 1024;

/// `softmax(q k^T / sqrt(c)) v` for `q` `[n, c]`, `k` `[m, c]` and `v` `[m, d]`: `[n, d]`. Holds at most [`QUERY_ROWS`]` * m`
/// scores at a time.
pub fn attend(q: Tensor<2>, k: Tensor<2>, v: Tensor<2>) -> Tensor<2> {
    let [_, c] = q.dims();
    let k = k.mul_scalar(1.0 / (c as f32).sqrt()).transpose();
    let rows = q.split(QUERY_ROWS, 0).into_iter().map(|q| softmax(q.matmul(k.clone()), 1).matmul(v.clone())).collect();
    Tensor::cat(rows, 0)
}
