//! What is remembered of a frame: its features and the object's mask, fused by two blocks of ConvNeXt (Liu et al., "A ConvNet for the
//! 2020s", CVPR 2022).

use super::memory_attention::MEMORY_WIDTH;
use super::neck::Pointwise;
use crate::ops::{conv, gelu, linear};
use crate::sam::{WIDTH, channel_norm};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::{Conv2d, Conv2dConfig};
use burn_nn::{Initializer, LayerNorm, Linear, PaddingConfig2d};

/// Channels of the mask, from its own size to a sixteenth.
const MASK_WIDTHS: [usize; 5] = [1, 4, 16, 64, WIDTH];

/// A mask as features. Named `0`, `3`, `6`, `9` and `1`, `4`, `7`, `10`, and `12` in the checkpoint.
#[derive(Module, Debug)]
pub struct MaskEncoder {
    convs: [Conv2d; 4],
    norms: [LayerNorm; 4],
    out: Conv2d,
}

impl MaskEncoder {
    fn new(device: &Device) -> Self {
        Self {
            convs: std::array::from_fn(|i| conv([MASK_WIDTHS[i], MASK_WIDTHS[i + 1]], 3, 2, true, device)),
            norms: std::array::from_fn(|i| channel_norm(MASK_WIDTHS[i + 1], device)),
            out: conv([WIDTH, WIDTH], 1, 1, true, device),
        }
    }

    /// Of `[b, 1, 16 h, 16 w]`: `[b, h, w, 256]`.
    fn forward(&self, mask: Tensor<4>) -> Tensor<4> {
        let mut x = mask.permute([0, 2, 3, 1]);
        for (conv, norm) in self.convs.iter().zip(&self.norms) {
            let smaller = conv.forward(x.permute([0, 3, 1, 2]));
            x = gelu(norm.forward(smaller.permute([0, 2, 3, 1])));
        }
        Pointwise::of(&self.out).forward(x)
    }
}

/// Where the checkpoint has the mask's encoder.
#[derive(Module, Debug)]
pub struct MaskDownsampler {
    encoder: MaskEncoder,
}

impl MaskDownsampler {
    /// Of `[b, 1, 16 h, 16 w]`: `[b, h, w, 256]`.
    pub fn forward(&self, mask: Tensor<4>) -> Tensor<4> {
        self.encoder.forward(mask)
    }
}

/// A block: each channel by itself, then each pixel by itself, scaled and added.
#[derive(Module, Debug)]
pub struct FuserBlock {
    dwconv: Conv2d,
    norm: LayerNorm,
    pwconv1: Linear,
    pwconv2: Linear,
    gamma: Param<Tensor<1>>,
}

impl FuserBlock {
    fn new(device: &Device) -> Self {
        Self {
            dwconv: Conv2dConfig::new([WIDTH, WIDTH], [7, 7])
                .with_padding(PaddingConfig2d::Explicit(3, 3, 3, 3))
                .with_groups(WIDTH)
                .with_initializer(Initializer::Zeros)
                .init(device),
            norm: channel_norm(WIDTH, device),
            pwconv1: linear(WIDTH, 4 * WIDTH, true, device),
            pwconv2: linear(4 * WIDTH, WIDTH, true, device),
            gamma: Initializer::Ones.init([WIDTH], device),
        }
    }

    /// Of `[b, h, w, 256]`: the same shape.
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let each = self.dwconv.forward(x.clone().permute([0, 3, 1, 2]));
        let normal = self.norm.forward(each.permute([0, 2, 3, 1]));
        let wide = gelu(self.pwconv1.forward(normal));
        x + self.pwconv2.forward(wide) * self.gamma.val().reshape([1, 1, 1, WIDTH])
    }
}

/// The blocks.
#[derive(Module, Debug)]
pub struct Fuser {
    layers: [FuserBlock; 2],
}

/// The encoder.
#[derive(Module, Debug)]
pub struct MemoryEncoder {
    /// The mask's part.
    pub mask_downsampler: MaskDownsampler,
    pix_feat_proj: Conv2d,
    fuser: Fuser,
    out_proj: Conv2d,
}

impl MemoryEncoder {
    pub fn new(device: &Device) -> Self {
        Self {
            mask_downsampler: MaskDownsampler { encoder: MaskEncoder::new(device) },
            pix_feat_proj: conv([WIDTH, WIDTH], 1, 1, true, device),
            fuser: Fuser { layers: std::array::from_fn(|_| FuserBlock::new(device)) },
            out_proj: conv([WIDTH, MEMORY_WIDTH], 1, 1, true, device),
        }
    }

    /// Of a frame's features `[1, h, w, 256]` and `b` masks `[b, 1, 16 h, 16 w]`, from -10 to 10: `[b, h, w, 64]`.
    pub fn forward(&self, map: Tensor<4>, masks: Tensor<4>) -> Tensor<4> {
        let mut x = Pointwise::of(&self.pix_feat_proj).forward(map) + self.mask_downsampler.forward(masks);
        for layer in &self.fuser.layers {
            x = layer.forward(x);
        }
        Pointwise::of(&self.out_proj).forward(x)
    }
}
