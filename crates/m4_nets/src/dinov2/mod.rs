//! DINOv2: the vision transformer that the networks for depth share.
//!
//! - Paper: Oquab et al., "DINOv2: Learning Robust Visual Features without Supervision", 2023; the
//!   blocks are those of Dosovitskiy et al., "An Image is Worth 16x16 Words", ICLR 2021, with the
//!   LayerScale of Touvron et al., "Going deeper with Image Transformers", ICCV 2021.
//! - Upstream: facebookresearch/dinov2, Apache-2.0. Networks for depth carry its weights, trained
//!   further, in their own checkpoints.
//!
//! ```text
//! image [b, 3, 14 h, 14 w] --patches of 14 x 14, class token, positions--> tokens [b, 1 + h w, c] --blocks--> tokens
//! ```
//!
//! What a block gives away passes the final normalisation first ([`DinoV2::taps`]). Fields are
//! named as in the checkpoint of the backbone itself; a network has it behind a prefix
//! (`pretrained.`, `encoder.backbone.`), which is the name of its own field or a rename.

#[cfg(test)]
mod tests;

use crate::LoadError;
use crate::load::Shapes;
use crate::ops::{
    Kernels, attend_heads, fine_norm, gelu, in_parts, linear, patch_conv, tensor, zeros,
};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{DType, Device, Tensor};
use burn_nn::conv::Conv2d;
use burn_nn::{Initializer, LayerNorm, Linear};
use std::path::Path;

/// Pixels of a side of a patch.
pub const PATCH: usize = 14;
/// Rows and columns of patches that the learned positions are for: 518 x 518 pixels.
const GRID: usize = 37;

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

/// Whether a tensor of a checkpoint of the backbone is of use in training alone: the token that
/// stands for a hidden patch.
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
        Self {
            cls_token: Initializer::Zeros.init([1, 1, width], device),
            pos_embed: Initializer::Zeros.init([1, 1 + GRID * GRID, width], device),
            patch_embed: PatchEmbed {
                proj: patch_conv([3, width], PATCH, device),
            },
            blocks: (0..depth).map(|_| Block::new(size, device)).collect(),
            norm: fine_norm(width, device),
            offset: OFFSET,
        }
    }

    /// The same with positions resized to a number of rows and columns, not by a scale
    /// (`interpolate_offset` 0 upstream).
    pub fn with_plain_positions(self) -> Self {
        Self {
            offset: 0.0,
            ..self
        }
    }

    pub fn depth(&self) -> usize {
        self.blocks.len()
    }

    /// What the blocks `taps` (counted from 0, ascending) give away of images `[b, 3, 14 h, 14 w]`
    /// that are normalised (ImageNet's mean and standard deviation). Blocks after the last of them
    /// are not run.
    pub fn taps<const N: usize>(&self, images: Tensor<4>, taps: [usize; N]) -> [Tap; N] {
        let mut run = self.run(images);
        taps.map(|block| {
            run.through(block);
            run.tap()
        })
    }

    /// The same step by step.
    pub fn run(&self, images: Tensor<4>) -> Run<'_> {
        Run {
            net: self,
            x: self.tokens(images),
            done: 0,
        }
    }

    /// Tokens as the first block takes them.
    fn tokens(&self, images: Tensor<4>) -> Tensor<3> {
        let images = images.cast(self.patch_embed.proj.weight.val().dtype());
        let maps = self.patch_embed.proj.forward(images);
        let [b, c, h, w] = maps.dims();
        let patches = maps.reshape([b, c, h * w]).swap_dims(1, 2);
        let class = self.cls_token.val().expand([b, 1, c]);
        let tokens = Tensor::cat(vec![class, patches], 1);
        let positions = resized(self.pos_embed.val(), h, w, self.offset).cast(tokens.dtype());
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
        Tap {
            patches: x.clone().narrow(1, 1, tokens - 1),
            class: x.narrow(1, 0, 1).squeeze_dim(1),
        }
    }
}

/// How wide and how deep a backbone is. All of them have heads of 64 channels and feed-forward
/// layers of four times the width.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum BackboneSize {
    /// ViT-S/14: 384 channels, 12 blocks, 22 million numbers.
    Small,
    /// ViT-B/14: 768 channels, 12 blocks, 87 million numbers.
    Base,
    /// ViT-L/14: 1024 channels, 24 blocks, 304 million numbers.
    Large,
}

impl BackboneSize {
    /// All of them, the smallest first.
    pub const ALL: [Self; 3] = [Self::Small, Self::Base, Self::Large];

    /// Channels of a token.
    #[must_use]
    pub fn width(self) -> usize {
        match self {
            Self::Small => 384,
            Self::Base => 768,
            Self::Large => 1024,
        }
    }

    #[must_use]
    pub fn depth(self) -> usize {
        match self {
            Self::Small | Self::Base => 12,
            Self::Large => 24,
        }
    }

    /// Heads of attention.
    #[must_use]
    pub fn heads(self) -> usize {
        self.width() / 64
    }

    /// The name in papers: `ViT-S`, `ViT-B`, `ViT-L`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Small => "ViT-S",
            Self::Base => "ViT-B",
            Self::Large => "ViT-L",
        }
    }

    /// The size of the backbone under `prefix` (with its final dot) in a checkpoint of `network`,
    /// as its class token tells. A file's name says nothing: a small network under the name of a
    /// large one is a small one.
    pub(crate) fn in_checkpoint(
        shapes: &Shapes,
        prefix: &str,
        network: &'static str,
        path: &Path,
    ) -> Result<Self, LoadError> {
        let name = format!("{prefix}cls_token");
        let Some(shape) = shapes.get(&name) else {
            return Err(LoadError::misfit(network, path, &[&name], &[]));
        };
        let variant = Self::ALL
            .into_iter()
            .find(|size| shape.last() == Some(&size.width()));
        variant.ok_or_else(|| {
            let sizes = Self::ALL.map(|size| format!("{} of {}", size.width(), size.name()));
            let wrong = format!(
                "{name} has the shape {shape:?}, known widths are {}",
                sizes.join(", ")
            );
            LoadError::misfit(network, path, &[], &[wrong])
        })
    }
}

/// Attention. Queries, keys and values come out of one linear layer.
#[derive(Module, Debug)]
pub struct Attention {
    qkv: Linear,
    proj: Linear,
    heads: usize,
}

impl Attention {
    pub fn new(width: usize, heads: usize, device: &Device) -> Self {
        Self {
            qkv: linear(width, 3 * width, true, device),
            proj: linear(width, width, true, device),
            heads,
        }
    }

    /// Of tokens `[b, n, c]`: the same shape.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let [b, n, c] = x.dims();
        let qkv = self
            .qkv
            .forward(x)
            .reshape([b, n, 3, self.heads, c / self.heads])
            .permute([2, 0, 3, 1, 4]);
        let [q, k, v] = [0, 1, 2].map(|i| qkv.clone().narrow(0, i, 1).squeeze_dim::<4>(0));
        let attention = attend_heads(q, k, v).swap_dims(1, 2).reshape([b, n, c]);
        self.proj.forward(attention)
    }
}

#[derive(Module, Debug)]
pub struct Block {
    norm1: LayerNorm,
    attn: Attention,
    ls1: LayerScale,
    norm2: LayerNorm,
    mlp: Mlp,
    ls2: LayerScale,
}

/// A factor a channel.
#[derive(Module, Debug)]
pub struct LayerScale {
    gamma: Param<Tensor<1>>,
}

impl LayerScale {
    /// Of `width` channels, waiting for its weights.
    pub fn new(width: usize, device: &Device) -> Self {
        Self {
            gamma: zeros([width], device),
        }
    }

    /// Of `x`, whose last axis are the channels.
    pub fn forward<const D: usize>(&self, x: Tensor<D>) -> Tensor<D> {
        x * self.gamma.val().unsqueeze()
    }
}

#[derive(Module, Debug)]
struct Mlp {
    fc1: Linear,
    fc2: Linear,
}

/// Tokens that the feed-forward layer takes at a time.
const MLP_TOKENS: usize = 512;

impl Mlp {
    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        in_parts(x, 1, MLP_TOKENS, |x| {
            self.fc2.forward(gelu(self.fc1.forward(x)))
        })
    }
}

impl Block {
    pub fn new(size: BackboneSize, device: &Device) -> Self {
        let width = size.width();
        Self {
            norm1: fine_norm(width, device),
            attn: Attention::new(width, size.heads(), device),
            ls1: LayerScale::new(width, device),
            norm2: fine_norm(width, device),
            mlp: Mlp {
                fc1: linear(width, 4 * width, true, device),
                fc2: linear(4 * width, width, true, device),
            },
            ls2: LayerScale::new(width, device),
        }
    }

    /// Of tokens `[b, n, c]`: the same shape.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let x = x.clone() + self.ls1.forward(self.attn.forward(self.norm1.forward(x)));
        x.clone() + self.ls2.forward(self.mlp.forward(self.norm2.forward(x)))
    }
}

/// What is added to a number of rows or columns before it becomes a scale: DINOv2 asks PyTorch's
/// `interpolate` (bicubic, a = -0.75, no antialiasing) for the scale `(h + 0.1) / 37`, so that
/// rounding cannot lose a row, and the samples lie `37 / (h + 0.1)` apart. Depth changes by a fifth
/// without that tenth. `UniDepth` V2 was trained without it.
pub const OFFSET: f64 = 0.1;

/// Positions `[1, 1 + h w, c]` in 32 bits, out of those `[1, 1 + 37 * 37, c]` that were learned,
/// with samples `37 / (h + offset)` apart.
pub fn resized(learned: Tensor<3>, h: usize, w: usize, offset: f64) -> Tensor<3> {
    let learned = learned.cast(DType::F32);
    if (h, w) == (GRID, GRID) {
        return learned;
    }
    let device = learned.device();
    let [_, _, c] = learned.dims();
    let along = |to: usize| {
        let kernels = Kernels::cubic_by_step(GRID, to, GRID as f64 / (to as f64 + offset));
        tensor(kernels.matrix(GRID), [to, GRID], &device)
    };
    let class = learned.clone().narrow(1, 0, 1);
    let rows: Tensor<2> = learned.narrow(1, 1, GRID * GRID).reshape([GRID, GRID * c]);
    let rows: Tensor<3> = along(h).matmul(rows).reshape([h, GRID, c]);
    let columns: Tensor<3> = along(w).unsqueeze();
    let patches = columns.matmul(rows).reshape([1, h * w, c]);
    Tensor::cat(vec![class, patches], 1)
}
