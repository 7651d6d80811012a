//! Hiera, the image encoder: four stages of blocks, each at half the resolution of the one before (Ryali et al., "Hiera: A Hierarchical
//! Vision Transformer without the Bells-and-Whistles", ICML 2023), with positions that are a learned map stretched over the image
//! and one repeated in windows (Bolya et al., "Window Attention is Bugged", ICLR 2024).

use super::block::Block;
use super::config::Config;
use crate::ops::{Kernels, resampled, tensor, zeros};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{DType, Device, Tensor};
use burn_nn::conv::{Conv2d, Conv2dConfig};
use burn_nn::{Initializer, PaddingConfig2d};

/// Pixels a side that become one.
pub const PATCH: usize = 4;

/// The first layer.
#[derive(Module, Debug)]
pub struct PatchEmbed {
    proj: Conv2d,
}

/// The encoder.
#[derive(Module, Debug)]
pub struct Hiera {
    /// `[1, c, s, s]`.
    pos_embed: Param<Tensor<4>>,
    /// `[1, c, 8, 8]`.
    pos_embed_window: Param<Tensor<4>>,
    patch_embed: PatchEmbed,
    /// All blocks.
    pub blocks: Vec<Block>,
}

impl Hiera {
    pub fn new(config: &Config, device: &Device) -> Self {
        let (c, s, window) = (config.width, config.background, config.windows[0]);
        let proj = Conv2dConfig::new([3, c], [7, 7])
            .with_stride([PATCH, PATCH])
            .with_padding(PaddingConfig2d::Explicit(3, 3, 3, 3))
            .with_initializer(Initializer::Zeros)
            .init(device);
        Self {
            pos_embed: zeros([1, c, s, s], device),
            pos_embed_window: zeros([1, c, window, window], device),
            patch_embed: PatchEmbed { proj },
            blocks: config.blocks().into_iter().map(|b| Block::new(b, device)).collect(),
        }
    }

    /// Positions of a map of `h` rows and `w` columns, multiples of the window: `[1, h, w, c]`, in 32 bits. Empty if the parameters cannot
    /// be read.
    pub fn positions(&self, [h, w]: [usize; 2]) -> Tensor<4> {
        let learned = self.pos_embed.val().cast(DType::F32);
        let device = learned.device();
        let [_, c, rows, columns] = learned.dims();
        let values: Vec<f32> = learned.try_into_vec_as().unwrap_or_default();
        let stretched = resampled(&values, columns, rows, &Kernels::cubic(columns, w), &Kernels::cubic(rows, h));
        let window = self.pos_embed_window.val().cast(DType::F32);
        let [_, _, side, _] = window.dims();
        let repeated = window.repeat(&[1, 1, h.div_ceil(side), w.div_ceil(side)]);
        let repeated = repeated.narrow(2, 0, h).narrow(3, 0, w);
        (tensor(stretched, [1, c, h, w], &device) + repeated).permute([0, 2, 3, 1])
    }

    /// Of an image `[1, 3, 4 h, 4 w]` and its `positions` `[1, h, w, c]`: what each stage ends with, `[1, h, w, c]`, then half the rows and
    /// columns and twice the channels per stage.
    pub fn forward(&self, image: Tensor<4>, positions: Tensor<4>) -> Vec<Tensor<4>> {
        let mut x = self.patch_embed.proj.forward(image).permute([0, 2, 3, 1]) + positions;
        let mut stages = Vec::new();
        for block in &self.blocks {
            x = block.forward(x);
            if block.ends {
                stages.push(x.clone());
            }
        }
        stages
    }
}
