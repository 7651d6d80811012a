//! DINOv2: the vision transformer that the networks for depth share.
//!
//! - Paper: Oquab et al., "DINOv2: Learning Robust Visual Features without Supervision", 2023; the blocks are those of Dosovitskiy et
//!   al., "An Image is Worth 16x16 Words", ICLR 2021, with the LayerScale of Touvron et al., "Going deeper with Image Transformers",
//!   ICCV 2021.
//! - Upstream: facebookresearch/dinov2, Apache-2.0. Networks for depth carry its weights, trained further, in their own checkpoints.
//!
//! ```text
//! image [b, 3, 14 h, 14 w] --patches of 14 x 14, class token, positions--> tokens [b, 1 + h w, c] --blocks--> tokens
//! ```
//!
//! What a block gives away passes the final normalisation first ([`DinoV2::taps`]). Fields are named as in the checkpoint of the
//! backbone itself; a network has it behind a prefix (`pretrained.`, `encoder.backbone.`), which is the name of its own field or a rename.

mod attention;
mod block;
mod positions;
mod size;
#[cfg(test)]
mod tests;

pub use size::BackboneSize;

use crate::ops::linear;
use block::Block;
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::{Conv2d, Conv2dConfig};
use burn_nn::{Initializer, LayerNorm, LayerNormConfig, Linear};

/// Pixels of a side of a patch.
pub const PATCH: usize = 14;
/// Rows and columns of patches that the learned positions are for: 518 x 518 pixels.
const GRID: usize = 37;

/// The backbone.
#[derive(Module, Debug)]
pub struct DinoV2 {
    cls_token: Param<Tensor<3>>,
    /// `[1, 1 + 37 * 37, c]`: the class token's, then those of the patches, row by row.
    pos_embed: Param<Tensor<3>>,
    patch_embed: PatchEmbed,
    blocks: Vec<Block>,
    norm: LayerNorm,
    /// What is added to a number of rows or columns of patches where positions are resized.
    offset: f64,
}

/// From patches to tokens.
#[derive(Module, Debug)]
struct PatchEmbed {
    proj: Conv2d,
}

/// What a block gives away, after the final normalisation.
#[derive(Debug, Clone)]
pub struct Tap {
    /// `[b, h w, c]`, row by row.
    pub patches: Tensor<3>,
    /// The class token, `[b, c]`.
    pub class: Tensor<2>,
}

/// Whether a tensor of a checkpoint of the backbone is of use in training alone: the token that stands for a hidden patch.
pub fn unneeded(name: &str) -> bool {
    name.rsplit('.').next() == Some("mask_token")
}

impl DinoV2 {
    /// The backbone of `size` that waits for its weights.
    pub fn new(size: BackboneSize, device: &Device) -> Self {
        Self::with_depth(size, size.depth(), device)
    }

    /// The same with `depth` blocks.
    pub fn with_depth(size: BackboneSize, depth: usize, device: &Device) -> Self {
        let width = size.width();
        let patches = Conv2dConfig::new([3, width], [PATCH, PATCH]).with_stride([PATCH, PATCH]);
        Self {
            cls_token: Initializer::Zeros.init([1, 1, width], device),
            pos_embed: Initializer::Zeros.init([1, 1 + GRID * GRID, width], device),
            patch_embed: PatchEmbed { proj: patches.with_initializer(Initializer::Zeros).init(device) },
            blocks: (0..depth).map(|_| Block::new(size, device)).collect(),
            norm: fine_norm(width, device),
            offset: positions::OFFSET,
        }
    }

    /// The same with positions resized to a number of rows and columns, not by a scale (`interpolate_offset` 0 upstream).
    pub fn with_plain_positions(self) -> Self {
        Self { offset: 0.0, ..self }
    }

    /// Blocks.
    pub fn depth(&self) -> usize {
        self.blocks.len()
    }

    /// What the blocks `taps` (counted from 0, ascending) give away of images `[b, 3, 14 h, 14 w]` that are normalised (ImageNet's mean and
    /// standard deviation). Blocks after the last of them are not run.
    pub fn taps<const N: usize>(&self, images: Tensor<4>, taps: [usize; N]) -> [Tap; N] {
        let mut run = self.run(images);
        taps.map(|block| {
            run.through(block);
            run.tap()
        })
    }

    /// The same step by step.
    pub fn run(&self, images: Tensor<4>) -> Run<'_> {
        Run { net: self, x: self.tokens(images), done: 0 }
    }

    /// Tokens as the first block takes them.
    fn tokens(&self, images: Tensor<4>) -> Tensor<3> {
        let images = images.cast(self.patch_embed.proj.weight.val().dtype());
        let maps = self.patch_embed.proj.forward(images);
        let [b, c, h, w] = maps.dims();
        let patches = maps.reshape([b, c, h * w]).swap_dims(1, 2);
        let class = self.cls_token.val().expand([b, 1, c]);
        let tokens = Tensor::cat(vec![class, patches], 1);
        let positions = positions::resized(self.pos_embed.val(), h, w, self.offset).cast(tokens.dtype());
        tokens + positions
    }
}

/// Tokens on their way through the blocks.
#[derive(Debug)]
pub struct Run<'a> {
    net: &'a DinoV2,
    x: Tensor<3>,
    done: usize,
}

impl Run<'_> {
    /// Runs the blocks up to `block`, counted from 0, and that one too; none if that has been done.
    pub fn through(&mut self, block: usize) {
        for block in self.net.blocks.iter().take(block + 1).skip(self.done) {
            self.x = block.forward(self.x.clone());
        }
        self.done = self.done.max(block + 1);
    }

    /// What is there now, normalised.
    pub fn tap(&self) -> Tap {
        let [_, tokens, _] = self.x.dims();
        let x = self.net.norm.forward(self.x.clone());
        Tap { patches: x.clone().narrow(1, 1, tokens - 1), class: x.narrow(1, 0, 1).squeeze_dim(1) }
    }
}

/// A layer normalisation over `width` channels that waits for its weights (epsilon 1e-6).
fn fine_norm(width: usize, device: &Device) -> LayerNorm {
    LayerNormConfig::new(width).with_epsilon(1e-6).init(device)
}

/// A linear layer with a bias.
fn biased(from: usize, to: usize, device: &Device) -> Linear {
    linear(from, to, true, device)
}
