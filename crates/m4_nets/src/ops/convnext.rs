//! A block of `ConvNeXt` (Liu et al., "A ConvNet for the 2020s", CVPR 2022), as SAM 2 and UniDepth
//! have it.

use super::{depthwise7, gelu, in_parts, linear, zeros};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::Conv2d;
use burn_nn::{LayerNorm, Linear};

/// Pixels that the wide layers take at a time.
const PIXELS: usize = 1024;

/// Each channel by itself, then each pixel by itself, scaled and added.
#[derive(Module, Debug)]
pub struct ConvNext {
    dwconv: Conv2d,
    norm: LayerNorm,
    pwconv1: Linear,
    pwconv2: Linear,
    gamma: Param<Tensor<1>>,
}

impl ConvNext {
    /// Of `width` channels, which `norm` is of.
    pub fn new(width: usize, norm: LayerNorm, device: &Device) -> Self {
        Self {
            dwconv: depthwise7(width, device),
            norm,
            pwconv1: linear(width, 4 * width, true, device),
            pwconv2: linear(4 * width, width, true, device),
            gamma: zeros([width], device),
        }
    }

    /// Of `[b, h, w, c]`: the same shape.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [b, h, w, c] = x.dims();
        let each = self.dwconv.forward(x.clone().permute([0, 3, 1, 2]));
        let pixels = each.permute([0, 2, 3, 1]).reshape([b * h * w, c]);
        let y = in_parts(pixels, 0, PIXELS, |y| {
            self.pwconv2
                .forward(gelu(self.pwconv1.forward(self.norm.forward(y))))
        });
        x + (y * self.gamma.val().unsqueeze()).reshape([b, h, w, c])
    }
}
