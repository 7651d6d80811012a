//! Maps of twice the size and half the channels.

use super::layers::by_tokens;
use crate::ops::{conv, gelu, linear, norm, zeros};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::activation::relu;
use burn_core::tensor::module::interpolate;
use burn_core::tensor::ops::{InterpolateMode, InterpolateOptions};
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::{Conv2d, Conv2dConfig};
use burn_nn::{Initializer, LayerNorm, Linear, PaddingConfig2d};

/// A convolution of 7 by 7, each channel by itself.
fn depthwise(width: usize, device: &Device) -> Conv2d {
    Conv2dConfig::new([width, width], [7, 7])
        .with_groups(width)
        .with_padding(PaddingConfig2d::Explicit(3, 3, 3, 3))
        .with_initializer(Initializer::Zeros)
        .init(device)
}

/// A block of `ConvNeXt` (Liu et al., "A ConvNet for the 2020s", CVPR 2022).
#[derive(Module, Debug)]
struct ConvNext {
    gamma: Param<Tensor<1>>,
    dwconv: Conv2d,
    norm: LayerNorm,
    pwconv1: Linear,
    pwconv2: Linear,
}

impl ConvNext {
    fn new(width: usize, device: &Device) -> Self {
        Self {
            gamma: zeros([width], device),
            dwconv: depthwise(width, device),
            norm: norm(width, device),
            pwconv1: linear(width, 4 * width, true, device),
            pwconv2: linear(4 * width, width, true, device),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = tokens(self.dwconv.forward(x.clone()));
        let y = by_tokens(y, |y| self.pwconv2.forward(gelu(self.pwconv1.forward(self.norm.forward(y)))));
        let [_, _, h, w] = x.dims();
        x + map(y * self.gamma.val().unsqueeze(), h, w)
    }
}

/// What follows the blocks: a shuffle of channels into pixels and two convolutions, beside a plain enlargement. `up_depthwise` and
/// `up_conv` are named `up.1` and `up.3` in the checkpoint, `residual` is `residual.0`.
#[derive(Module, Debug)]
pub struct Up {
    convs: [ConvNext; 2],
    up_depthwise: Conv2d,
    up_conv: Conv2d,
    residual: Conv2d,
}

impl Up {
    pub fn new(width: usize, device: &Device) -> Self {
        Self {
            convs: [ConvNext::new(width, device), ConvNext::new(width, device)],
            up_depthwise: depthwise(width / 4, device),
            up_conv: conv([width / 4, width / 2], 3, 1, true, device),
            residual: conv([width, width / 2], 1, 1, true, device),
        }
    }

    /// Of tokens `[h w, c]`: tokens `[4 h w, c / 2]`.
    pub fn forward(&self, x: Tensor<2>, h: usize, w: usize) -> Tensor<2> {
        let x = self.convs.iter().fold(map(x, h, w), |x, block| block.forward(x));
        let shuffled = relu(self.up_depthwise.forward(pixels_of_channels(x.clone())));
        let options = InterpolateOptions::new(InterpolateMode::Bilinear)
            .with_align_corners(true)
            .with_output_size([2 * h, 2 * w]);
        tokens(self.up_conv.forward(shuffled) + interpolate(self.residual.forward(x), options))
    }
}

/// Four channels as 2 by 2 pixels: `[1, c, h, w]` as `[1, c / 4, 2 h, 2 w]`.
fn pixels_of_channels(x: Tensor<4>) -> Tensor<4> {
    let [_, c, h, w] = x.dims();
    x.reshape([c / 4, 2, 2, h, w]).permute([0, 3, 1, 4, 2]).reshape([1, c / 4, 2 * h, 2 * w])
}

/// A map `[1, c, h, w]` as tokens `[h w, c]`.
pub fn tokens(x: Tensor<4>) -> Tensor<2> {
    let [_, c, h, w] = x.dims();
    x.reshape([c, h * w]).transpose()
}

/// Tokens `[h w, c]` as a map `[1, c, h, w]`.
pub fn map(x: Tensor<2>, h: usize, w: usize) -> Tensor<4> {
    let [_, c] = x.dims();
    x.transpose().reshape([1, c, h, w])
}
