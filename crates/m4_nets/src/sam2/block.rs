//! A block of the image encoder: attention within windows or over the whole image, then the feed-forward layer; the first of a
//! stage halves rows and columns, its queries being the largest of 2 by 2.

use super::config::BlockConfig;
use super::windows::{cut, halved, joined};
use crate::ops::{attend_heads, gelu, linear};
use crate::sam::channel_norm;
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::{Device, Tensor};
use burn_nn::{LayerNorm, Linear};

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
        let found = attend_heads(split(q, rows * columns), split(k, h * w), split(v, h * w));
        self.proj.forward(found.swap_dims(1, 2).reshape([n, rows, columns, c]))
    }
}

/// The feed-forward layer.
#[derive(Module, Debug)]
pub struct Mlp {
    layers: [Linear; 2],
}

/// Pixels that the feed-forward layer takes at a time on the processor: their wide channels stay near.
const MLP_PIXELS: usize = 1024;

impl Mlp {
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [n, h, w, c] = x.dims();
        let [wide, narrow] = &self.layers;
        let some = |x: Tensor<2>| narrow.forward(gelu(wide.forward(x)));
        let x = x.reshape([n * h * w, c]);
        let x = if x.device() == Device::flex() {
            Tensor::cat(x.split(MLP_PIXELS, 0).into_iter().map(some).collect(), 0)
        } else {
            some(x)
        };
        x.reshape([n, h, w, c])
    }
}

/// A block.
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
            norm1: channel_norm(from, device),
            attn: Attention::new(config, device),
            norm2: channel_norm(to, device),
            mlp: Mlp { layers: [linear(to, 4 * to, true, device), linear(4 * to, to, true, device)] },
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
        let kept = match &self.proj {
            Some(proj) => {
                let x = proj.forward(normal.clone());
                if self.halves { halved(x) } else { x }
            }
            None => x,
        };
        let [_, h, w, _] = kept.dims();
        let found = if self.window == 0 {
            self.attn.forward(normal)
        } else {
            joined(self.attn.forward(cut(normal, self.window)), n, [h, w])
        };
        let x = kept + found;
        x.clone() + self.mlp.forward(self.norm2.forward(x))
    }
}
