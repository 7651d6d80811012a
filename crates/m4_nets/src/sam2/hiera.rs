//! Hiera, the image encoder: four stages of blocks, each at half the resolution of the one before
//! (Ryali et al., "Hiera: A Hierarchical Vision Transformer without the Bells-and-Whistles", ICML
//! 2023), with positions that are a learned map stretched over the image and one repeated in
//! windows (Bolya et al., "Window Attention is Bugged", ICLR 2024).

use super::config::{BlockConfig, Config};
use crate::ops::{
    Kernels, attend_heads, conv, fine_norm, gelu, in_parts, linear, resampled, tensor, zeros,
};
use crate::sam::{WIDTH, cut, joined};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{DType, Device, Tensor};
use burn_nn::conv::Conv2d;
use burn_nn::{LayerNorm, Linear};

/// Pixels a side that become one.
pub const PATCH: usize = 4;

#[derive(Module, Debug)]
pub struct Hiera {
    /// `[1, c, s, s]`.
    pos_embed: Param<Tensor<4>>,
    /// `[1, c, 8, 8]`.
    pos_embed_window: Param<Tensor<4>>,
    patch_embed: Conv2d,
    pub blocks: Vec<Block>,
}

impl Hiera {
    pub fn new(config: &Config, device: &Device) -> Self {
        let (c, s, window) = (config.width, config.background, config.windows[0]);
        Self {
            pos_embed: zeros([1, c, s, s], device),
            pos_embed_window: zeros([1, c, window, window], device),
            patch_embed: conv([3, c], 7, PATCH, true, device),
            blocks: config
                .blocks()
                .into_iter()
                .map(|b| Block::new(b, device))
                .collect(),
        }
    }

    /// Positions of a map of `h` rows and `w` columns, multiples of the window: `[1, h, w, c]`, in
    /// 32 bits. Empty if the parameters cannot be read.
    pub fn positions(&self, [h, w]: [usize; 2]) -> Tensor<4> {
        let learned = self.pos_embed.val().cast(DType::F32);
        let device = learned.device();
        let [_, c, rows, columns] = learned.dims();
        let values: Vec<f32> = learned.try_into_vec_as().unwrap_or_default();
        let stretched = resampled(
            &values,
            columns,
            rows,
            &Kernels::cubic(columns, w),
            &Kernels::cubic(rows, h),
        );
        let window = self.pos_embed_window.val().cast(DType::F32);
        let [_, _, side, _] = window.dims();
        let repeated = window.repeat(&[1, 1, h.div_ceil(side), w.div_ceil(side)]);
        let repeated = repeated.narrow(2, 0, h).narrow(3, 0, w);
        (tensor(stretched, [1, c, h, w], &device) + repeated).permute([0, 2, 3, 1])
    }

    /// Of an image `[1, 3, 4 h, 4 w]` and its `positions` `[1, h, w, c]`: what each stage ends
    /// with, `[1, h, w, c]`, then half the rows and columns and twice the channels per stage.
    pub fn forward(&self, image: Tensor<4>, positions: Tensor<4>) -> Vec<Tensor<4>> {
        let mut x = self.patch_embed.forward(image).permute([0, 2, 3, 1]) + positions;
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

/// Attention. Queries, keys and values come out of one linear layer.
#[derive(Module, Debug)]
pub struct Attention {
    qkv: Linear,
    proj: Linear,
    heads: usize,
    halves: bool,
}

impl Attention {
    fn new(config: BlockConfig, device: &Device) -> Self {
        Self {
            qkv: linear(config.from, 3 * config.to, true, device),
            proj: linear(config.to, config.to, true, device),
            heads: config.heads,
            halves: config.halves,
        }
    }

    /// Of maps `[n, h, w, from]`, each by itself: `[n, h, w, to]`, or half the rows and columns.
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [n, h, w, _] = x.dims();
        let qkv = self.qkv.forward(x);
        let [_, _, _, three] = qkv.dims();
        let (c, heads) = (three / 3, self.heads);
        let [q, k, v] = [0, 1, 2].map(|i| qkv.clone().narrow(3, i * c, c));
        let q = if self.halves { halved(q) } else { q };
        let [_, rows, columns, _] = q.dims();
        let split = |x: Tensor<4>, l: usize| x.reshape([n, l, heads, c / heads]).swap_dims(1, 2);
        let attention = attend_heads(split(q, rows * columns), split(k, h * w), split(v, h * w));
        self.proj
            .forward(attention.swap_dims(1, 2).reshape([n, rows, columns, c]))
    }
}

#[derive(Module, Debug)]
pub struct Mlp {
    layers: [Linear; 2],
}

/// Pixels that the feed-forward layer takes at a time.
const MLP_PIXELS: usize = 1024;

impl Mlp {
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [n, h, w, c] = x.dims();
        let [wide, narrow] = &self.layers;
        let pixels = x.reshape([n * h * w, c]);
        in_parts(pixels, 0, MLP_PIXELS, |x| {
            narrow.forward(gelu(wide.forward(x)))
        })
        .reshape([n, h, w, c])
    }
}

#[derive(Module, Debug)]
pub struct Block {
    norm1: LayerNorm,
    attn: Attention,
    norm2: LayerNorm,
    mlp: Mlp,
    /// Where the number of channels changes.
    proj: Option<Linear>,
    /// Side of the windows, 0 for the whole image.
    window: usize,
    halves: bool,
    /// Whether it is the last of its stage.
    pub ends: bool,
}

impl Block {
    pub fn new(config: BlockConfig, device: &Device) -> Self {
        let BlockConfig { from, to, .. } = config;
        Self {
            norm1: fine_norm(from, device),
            attn: Attention::new(config, device),
            norm2: fine_norm(to, device),
            mlp: Mlp {
                layers: [
                    linear(to, 4 * to, true, device),
                    linear(4 * to, to, true, device),
                ],
            },
            proj: (from != to).then(|| linear(from, to, true, device)),
            window: config.window.unwrap_or(0),
            halves: config.halves,
            ends: config.ends,
        }
    }

    /// Of `[n, h, w, from]`: `[n, h, w, to]`, or half the rows and columns.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [n, _, _, _] = x.dims();
        let normal = self.norm1.forward(x.clone());
        let shortcut = match &self.proj {
            Some(proj) => {
                let x = proj.forward(normal.clone());
                if self.halves { halved(x) } else { x }
            }
            None => x,
        };
        let [_, h, w, _] = shortcut.dims();
        let attention = if self.window == 0 {
            self.attn.forward(normal)
        } else {
            joined(self.attn.forward(cut(normal, self.window)), n, [h, w])
        };
        let x = shortcut + attention;
        x.clone() + self.mlp.forward(self.norm2.forward(x))
    }
}

/// The largest of each 2 by 2 pixels of `x` `[n, h, w, c]`: `[n, h / 2, w / 2, c]`; a last odd row
/// or column is left out.
pub fn halved(x: Tensor<4>) -> Tensor<4> {
    let [n, h, w, c] = x.dims();
    let [rows, columns] = [h / 2, w / 2];
    let x =
        x.narrow(1, 0, 2 * rows)
            .narrow(2, 0, 2 * columns)
            .reshape([n * rows, 2, columns, 2 * c]);
    let x = x.clone().narrow(1, 0, 1).max_pair(x.narrow(1, 1, 1));
    let x = x.reshape([n, rows, columns, 2 * c]);
    x.clone().narrow(3, 0, c).max_pair(x.narrow(3, c, c))
}

#[derive(Module, Debug)]
pub struct Neck {
    /// From the coarsest stage to the finest.
    convs: [Conv2d; 4],
}

#[derive(Module, Debug)]
pub struct ImageEncoder {
    pub trunk: Hiera,
    pub neck: Neck,
}

/// A linear layer of pixels: `[from, to]` and `[1, to]`.
#[derive(Debug, Clone)]
pub struct Pointwise {
    weight: Tensor<2>,
    bias: Tensor<2>,
}

impl Pointwise {
    /// Of a convolution whose kernel is one pixel.
    pub fn of(conv: &Conv2d) -> Self {
        let weight = conv.weight.val();
        let [to, from, _, _] = weight.dims();
        let bias = match &conv.bias {
            Some(bias) => bias.val(),
            None => Tensor::zeros([to], (&weight.device(), weight.dtype())),
        };
        Self {
            weight: weight.reshape([to, from]).transpose(),
            bias: bias.unsqueeze(),
        }
    }

    /// This one, and `next` after it.
    pub fn then(self, next: &Self) -> Self {
        Self {
            weight: self.weight.matmul(next.weight.clone()),
            bias: self.bias.matmul(next.weight.clone()) + next.bias.clone(),
        }
    }

    /// In another precision.
    pub fn cast(self, dtype: DType) -> Self {
        Self {
            weight: self.weight.cast(dtype),
            bias: self.bias.cast(dtype),
        }
    }

    /// Of `[n, h, w, from]`: `[n, h, w, to]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [n, h, w, from] = x.dims();
        let [_, to] = self.weight.dims();
        let x = x.reshape([n * h * w, from]).matmul(self.weight.clone()) + self.bias.clone();
        x.reshape([n, h, w, to])
    }
}

impl Neck {
    pub fn new(config: &Config, device: &Device) -> Self {
        Self {
            convs: std::array::from_fn(|i| {
                conv([config.width_of(3 - i), WIDTH], 1, 1, true, device)
            }),
        }
    }

    /// The layer of a stage, 0 for the finest.
    pub fn of_stage(&self, stage: usize) -> Pointwise {
        Pointwise::of(&self.convs[3 - stage])
    }
}

/// `x` `[n, h, w, c]` with each pixel four times: `[n, 2 h, 2 w, c]`.
pub fn repeated(x: Tensor<4>) -> Tensor<4> {
    let [n, h, w, c] = x.dims();
    x.reshape([n, h, 1, w, 1, c])
        .expand([n, h, 2, w, 2, c])
        .reshape([n, 2 * h, 2 * w, c])
}
