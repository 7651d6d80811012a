//! Operations that several layers share. What changed between versions of Burn is called from here.

mod activations;
mod attention;
mod convnext;
mod convolution;
mod resample;

pub use activations::{gelu, gelu_by_tanh, sigmoid, tanh};
pub use attention::{attend_heads, softmax_rows};
pub use convnext::ConvNext;
pub use convolution::{convolve, convolve_edges};
pub use resample::{Kernels, bilinear, bilinear_plane, image_tensor, resampled};

use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::activation::softmax;
use burn_core::tensor::module::{interpolate, layer_norm};
use burn_core::tensor::ops::{InterpolateMode, InterpolateOptions, PadMode};
use burn_core::tensor::{DType, Device, Tensor, TensorData};
use burn_nn::conv::{Conv2d, Conv2dConfig, ConvTranspose2d, ConvTranspose2dConfig};
use burn_nn::{Initializer, LayerNorm, LayerNormConfig, Linear, LinearConfig, PaddingConfig2d};
use m4_core::RgbImage;
use std::f32::consts::TAU;

/// A tensor of `values` in the shape `shape`, row by row.
pub fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// A parameter that waits for its weights.
pub fn zeros<const D: usize>(shape: [usize; D], device: &Device) -> Param<Tensor<D>> {
    Initializer::Zeros.init(shape, device)
}

/// A square convolution of `[from, to]` channels that waits for its weights, padded by half its
/// kernel.
pub fn conv(
    channels: [usize; 2],
    kernel: usize,
    stride: usize,
    bias: bool,
    device: &Device,
) -> Conv2d {
    Conv2d {
        stride: [stride, stride],
        ..conv_by(channels, [kernel, kernel], bias, device)
    }
}

/// A convolution of `[from, to]` channels by a kernel of that many rows and columns that waits for
/// its weights, padded by half of it.
pub fn conv_by(channels: [usize; 2], kernel: [usize; 2], bias: bool, device: &Device) -> Conv2d {
    let [y, x] = kernel.map(|side| side / 2);
    let config =
        Conv2dConfig::new(channels, kernel).with_padding(PaddingConfig2d::Explicit(y, x, y, x));
    config
        .with_bias(bias)
        .with_initializer(Initializer::Zeros)
        .init(device)
}

/// A convolution whose kernels of `side` by `side` pixels lie side by side, which waits for its
/// weights.
pub fn patch_conv(channels: [usize; 2], side: usize, device: &Device) -> Conv2d {
    let config = Conv2dConfig::new(channels, [side, side]).with_stride([side, side]);
    config.with_initializer(Initializer::Zeros).init(device)
}

/// A convolution of 7 by 7, each channel by itself, that waits for its weights.
pub fn depthwise7(width: usize, device: &Device) -> Conv2d {
    let config = Conv2dConfig::new([width, width], [7, 7]).with_groups(width);
    config
        .with_padding(PaddingConfig2d::Explicit(3, 3, 3, 3))
        .with_initializer(Initializer::Zeros)
        .init(device)
}

/// A transposed convolution to `times` the rows and columns, whose kernels do not overlap; it waits
/// for its weights.
pub fn upscaling_conv(channels: [usize; 2], times: usize, device: &Device) -> ConvTranspose2d {
    let config = ConvTranspose2dConfig::new(channels, [times, times]).with_stride([times, times]);
    config.with_initializer(Initializer::Zeros).init(device)
}

/// `x` `[n, c, h, w]` with `size` rows and columns, bilinear; `corners` if corner pixels stay at
/// the corners.
pub fn interpolated(x: Tensor<4>, size: [usize; 2], corners: bool) -> Tensor<4> {
    let options = InterpolateOptions::new(InterpolateMode::Bilinear);
    interpolate(
        x,
        options.with_align_corners(corners).with_output_size(size),
    )
}

/// `conv` with other weights `[out, in, h, w]` of its kernel's size.
pub fn with_weights(conv: Conv2d, weight: Tensor<4>, bias: Option<Tensor<1>>) -> Conv2d {
    Conv2d {
        weight: Param::from_tensor(weight),
        bias: bias.map(Param::from_tensor),
        ..conv
    }
}

/// A linear layer that waits for its weights.
pub fn linear(from: usize, to: usize, bias: bool, device: &Device) -> Linear {
    LinearConfig::new(from, to)
        .with_bias(bias)
        .with_initializer(Initializer::Zeros)
        .init(device)
}

/// A layer normalisation over `width` channels that waits for its weights.
pub fn norm(width: usize, device: &Device) -> LayerNorm {
    LayerNormConfig::new(width).init(device)
}

/// The same with epsilon 1e-6 instead of 1e-5.
pub fn fine_norm(width: usize, device: &Device) -> LayerNorm {
    LayerNormConfig::new(width).with_epsilon(1e-6).init(device)
}

/// `norm` over the channels of `x` `[n, c, h, w]`.
pub fn over_channels(norm: &LayerNorm, x: Tensor<4>) -> Tensor<4> {
    norm.forward(x.permute([0, 2, 3, 1])).permute([0, 3, 1, 2])
}

/// `layer` of `x`: on the processor of `most` rows along `axis` at a time, so that its wide
/// channels stay in the cache.
pub fn in_parts<const D: usize>(
    x: Tensor<D>,
    axis: usize,
    most: usize,
    layer: impl Fn(Tensor<D>) -> Tensor<D>,
) -> Tensor<D> {
    if x.device() != Device::flex() {
        return layer(x);
    }
    Tensor::cat(x.split(most, axis).into_iter().map(layer).collect(), axis)
}

/// Each channel of each image of `x` `[n, c, h, w]` less its mean, divided by its standard
/// deviation (over the `h * w` pixels, epsilon 1e-5): instance normalisation without weights. Sums
/// are made in 32 bits, whatever `x` is in.
pub fn instance_norm(x: Tensor<4>) -> Tensor<4> {
    let [n, c, h, w] = x.dims();
    let dtype = x.dtype();
    let ones = Tensor::ones([h * w], (&x.device(), DType::F32));
    let x = x.cast(DType::F32).reshape([n, c, h * w]);
    layer_norm(x, ones, None, 1e-5)
        .reshape([n, c, h, w])
        .cast(dtype)
}

/// Mean of red, green and blue that most weights were trained with (ImageNet's).
pub const IMAGENET_MEAN: [f32; 3] = [0.485, 0.456, 0.406];
/// Their standard deviation.
pub const IMAGENET_STD: [f32; 3] = [0.229, 0.224, 0.225];

/// Red, green and blue of `image` from 0 to 1, less `mean`, divided by `std`: `[3][height][width]`.
pub fn planes(image: &RgbImage, mean: [f32; 3], std: [f32; 3]) -> Vec<f32> {
    let plane = |c: usize| {
        let value = move |p: &[u8; 3]| (f32::from(p[c]) / 255.0 - mean[c]) / std[c];
        image.data().iter().map(value)
    };
    (0..3).flat_map(plane).collect()
}

/// The position of each pixel of a map of `h` rows and `w` columns, `[1, h, w, channels]`: sines
/// and cosines of row, then column, at wavelengths from 1 to 10,000, a quarter of the channels each
/// (DETR).
pub fn sine_positions([h, w]: [usize; 2], channels: usize, device: &Device) -> Tensor<4> {
    let half = channels / 2;
    let wave = |at: usize, side: usize, channel: usize| {
        let angle = (at + 1) as f32 / (side as f32 + 1e-6) * TAU;
        let angle = angle / 10_000f32.powf((channel / 2 * 2) as f32 / half as f32);
        if channel.is_multiple_of(2) {
            angle.sin()
        } else {
            angle.cos()
        }
    };
    let table = |side: usize| -> Vec<f32> {
        (0..side * half)
            .map(|i| wave(i / half, side, i % half))
            .collect()
    };
    let rows: Tensor<4> = tensor(table(h), [1, h, 1, half], device);
    let columns: Tensor<4> = tensor(table(w), [1, 1, w, half], device);
    Tensor::cat(
        vec![
            rows.expand([1, h, w, half]),
            columns.expand([1, h, w, half]),
        ],
        3,
    )
}

/// The 3 by 3 values around each pixel of `x` `[h, w, d]`, row by row: `[h, w, 9, d]`; 0 outside.
fn neighbours(x: Tensor<3>) -> Tensor<4> {
    let [h, w, _] = x.dims();
    let x = x.pad([(1, 1), (1, 1), (0, 0)], PadMode::Constant(0.0));
    let shifted = (0..9)
        .map(|i| x.clone().narrow(0, i / 3, h).narrow(1, i % 3, w))
        .collect();
    Tensor::stack(shifted, 2)
}

/// Of `flow` `[h, w, 2]` (pixels of the map): the flow `[factor h, factor w, 2]` in pixels of the
/// image, which has `factor` times the sides. `weights` are `[9 factor factor, h, w]`: neighbour,
/// then row and column within the pixel; their softmax over the neighbours is what counts.
pub fn convex_upsample(flow: Tensor<3>, weights: Tensor<3>, factor: usize) -> Tensor<3> {
    let [h, w, _] = flow.dims();
    // [9, factor factor, h, w] -> [h, w, factor factor, 9]
    let weights = weights
        .reshape([9, factor * factor, h, w])
        .permute([2, 3, 1, 0]);
    softmax(weights, 3)
        .matmul(neighbours(flow.mul_scalar(factor as f32)))
        .reshape([h, w, factor, factor, 2])
        .permute([0, 2, 1, 3, 4])
        .reshape([h * factor, w * factor, 2])
}

/// Batch normalisation adds this to the variance.
const EPSILON: f32 = 1e-5;

/// What batch normalisation learned, a number per channel each.
#[derive(Module, Debug)]
pub struct Statistics {
    weight: Param<Tensor<1>>,
    bias: Param<Tensor<1>>,
    running_mean: Param<Tensor<1>>,
    running_var: Param<Tensor<1>>,
}

impl Statistics {
    /// Of `width` channels, waiting for its weights.
    pub fn new(width: usize, device: &Device) -> Self {
        Self {
            weight: zeros([width], device),
            bias: zeros([width], device),
            running_mean: zeros([width], device),
            running_var: zeros([width], device),
        }
    }

    /// Of how many channels.
    pub fn width(&self) -> usize {
        let [width] = self.weight.dims();
        width
    }

    /// The convolution `kernel` `[out, in, h, w]` and `bias` followed by this: again a convolution.
    pub fn after(&self, kernel: Tensor<4>, bias: Option<Tensor<1>>) -> (Tensor<4>, Tensor<1>) {
        let scale = self.weight.val() / (self.running_var.val() + EPSILON).sqrt();
        let mean = match bias {
            Some(bias) => self.running_mean.val() - bias,
            None => self.running_mean.val(),
        };
        let bias = self.bias.val() - mean * scale.clone();
        (kernel * scale.reshape([self.width(), 1, 1, 1]), bias)
    }
}
