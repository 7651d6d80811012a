//! A frame's features in the light of what is remembered: four layers of attention among the pixels, attention to memories, and a
//! feed-forward layer.
//!
//! Attention to memories weighs the memories as they are, in 64 channels, and projects to 256 what comes out, where upstream
//! projects each memory before: the same but for rounding, as weights sum to one, for a quarter of the operations.

use super::rope::{Rotations, halves_apart};
use crate::ops::{attend_heads, linear, norm};
use crate::sam::WIDTH;
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{Device, Tensor};
use burn_nn::{LayerNorm, Linear};

/// Channels of memories.
pub const MEMORY_WIDTH: usize = 64;
const LAYERS: usize = 4;
const MLP_WIDTH: usize = 2048;
/// Pixels that the feed-forward layer takes at a time on the processor.
const MLP_PIXELS: usize = 512;

/// Attention with one head.
#[derive(Module, Debug)]
pub struct Attention {
    q_proj: Linear,
    k_proj: Linear,
    v_proj: Linear,
    out_proj: Linear,
}

/// What is attended to.
#[derive(Debug, Clone)]
pub struct Memories {
    /// `[b, m, 64]`.
    pub values: Tensor<3>,
    /// The same with their positions.
    pub keys: Tensor<3>,
    /// How many of them, the first, are pixels of whole maps; those after them have no place.
    pub placed: usize,
}

impl Attention {
    fn new(from: usize, device: &Device) -> Self {
        Self {
            q_proj: linear(WIDTH, WIDTH, true, device),
            k_proj: linear(from, WIDTH, true, device),
            v_proj: linear(from, WIDTH, true, device),
            out_proj: linear(WIDTH, WIDTH, true, device),
        }
    }

    /// As [`Rotations`] takes queries and keys.
    fn arranged(self) -> Self {
        Self { q_proj: halves_apart(self.q_proj), k_proj: halves_apart(self.k_proj), ..self }
    }

    /// Of the pixels `x` `[b, n, 256]` among themselves.
    pub fn among(&self, x: Tensor<3>, rotations: &Rotations) -> Tensor<3> {
        let q = rotations.turn(self.q_proj.forward(x.clone()));
        let k = rotations.turn(self.k_proj.forward(x.clone()));
        let v = self.v_proj.forward(x);
        self.out_proj.forward(of_one_head(q, k, v))
    }

    /// Of the pixels `x`, `[b, n, 256]` or one for all `b`, to memories.
    pub fn to(&self, x: Tensor<3>, memories: &Memories, rotations: &Rotations) -> Tensor<3> {
        let [b, m, _] = memories.keys.dims();
        let [_, n, c] = x.dims();
        let q = rotations.turn(self.q_proj.forward(x)).expand([b, n, c]);
        let keys = self.k_proj.forward(memories.keys.clone());
        let placed = memories.placed;
        let mut parts = Vec::new();
        if placed > 0 {
            parts.push(rotations.turn(keys.clone().narrow(1, 0, placed)));
        }
        if m > placed {
            parts.push(keys.narrow(1, placed, m - placed));
        }
        let found = of_one_head(q, Tensor::cat(parts, 1), memories.values.clone());
        self.out_proj.forward(self.v_proj.forward(found))
    }
}

fn of_one_head(q: Tensor<3>, k: Tensor<3>, v: Tensor<3>) -> Tensor<3> {
    attend_heads(q.unsqueeze_dim(1), k.unsqueeze_dim(1), v.unsqueeze_dim(1)).squeeze_dim(1)
}

/// A layer.
#[derive(Module, Debug)]
pub struct Layer {
    /// Among pixels.
    pub self_attn: Attention,
    /// To memories.
    pub cross_attn_image: Attention,
    linear1: Linear,
    linear2: Linear,
    norm1: LayerNorm,
    norm2: LayerNorm,
    norm3: LayerNorm,
}

impl Layer {
    fn new(device: &Device) -> Self {
        Self {
            self_attn: Attention::new(WIDTH, device),
            cross_attn_image: Attention::new(MEMORY_WIDTH, device),
            linear1: linear(WIDTH, MLP_WIDTH, true, device),
            linear2: linear(MLP_WIDTH, WIDTH, true, device),
            norm1: norm(WIDTH, device),
            norm2: norm(WIDTH, device),
            norm3: norm(WIDTH, device),
        }
    }

    fn among(&self, x: Tensor<3>, rotations: &Rotations) -> Tensor<3> {
        x.clone() + self.self_attn.among(self.norm1.forward(x), rotations)
    }

    fn to(&self, x: Tensor<3>, memories: &Memories, rotations: &Rotations) -> Tensor<3> {
        x.clone() + self.cross_attn_image.to(self.norm2.forward(x), memories, rotations)
    }

    fn feed(&self, x: Tensor<3>) -> Tensor<3> {
        let some = |x: Tensor<3>| self.linear2.forward(relu(self.linear1.forward(x)));
        let normal = self.norm3.forward(x.clone());
        if x.device() == Device::flex() {
            let parts = normal.split(MLP_PIXELS, 1).into_iter().map(some).collect();
            x + Tensor::cat(parts, 1)
        } else {
            x + some(normal)
        }
    }
}

/// The layers.
#[derive(Module, Debug)]
pub struct MemoryAttention {
    /// One after the other.
    pub layers: [Layer; LAYERS],
    norm: LayerNorm,
}

impl MemoryAttention {
    pub fn new(device: &Device) -> Self {
        Self { layers: std::array::from_fn(|_| Layer::new(device)), norm: norm(WIDTH, device) }
    }

    /// As [`Rotations`] takes queries and keys: once, after loading.
    pub fn arranged(self) -> Self {
        Self {
            layers: self.layers.map(|layer| Layer {
                self_attn: layer.self_attn.arranged(),
                cross_attn_image: layer.cross_attn_image.arranged(),
                ..layer
            }),
            norm: self.norm,
        }
    }

    /// What depends on the frame alone: its features `map` `[1, n, 256]`, whose places are `places`, after the first layer's attention among
    /// themselves.
    pub fn begun(&self, map: Tensor<3>, places: &Tensor<3>, rotations: &Rotations) -> Tensor<3> {
        let [first, ..] = &self.layers;
        first.among(map + places.clone().mul_scalar(0.1), rotations)
    }

    /// What is [`begun`](Self::begun), `[1, n, 256]`, in the light of `b` sets of memories: `[b, n, 256]`.
    pub fn forward(&self, begun: Tensor<3>, memories: &Memories, rotations: &Rotations) -> Tensor<3> {
        let mut x = begun;
        for (i, layer) in self.layers.iter().enumerate() {
            if i > 0 {
                x = layer.among(x, rotations);
            }
            x = layer.feed(layer.to(x, memories, rotations));
        }
        self.norm.forward(x)
    }
}
