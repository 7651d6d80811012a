//! A transformer block: attention, then the feed-forward layer, each with pre-normalisation, a per-channel scale and a residual.

use super::attention::Attention;
use super::{BackboneSize, biased, fine_norm};
use crate::ops::gelu;
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};
use burn_nn::{Initializer, LayerNorm, Linear};

/// A block.
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
struct LayerScale {
    gamma: Param<Tensor<1>>,
}

impl LayerScale {
    fn new(width: usize, device: &Device) -> Self {
        Self { gamma: Initializer::Ones.init([width], device) }
    }

    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        x * self.gamma.val().unsqueeze()
    }
}

/// The feed-forward layer.
#[derive(Module, Debug)]
struct Mlp {
    fc1: Linear,
    fc2: Linear,
}

/// Tokens that the feed-forward layer takes at a time: their wide channels stay near.
const MLP_TOKENS: usize = 512;

impl Mlp {
    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let some = |x| self.fc2.forward(gelu(self.fc1.forward(x)));
        Tensor::cat(x.split(MLP_TOKENS, 1).into_iter().map(some).collect(), 1)
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
            mlp: Mlp { fc1: biased(width, 4 * width, device), fc2: biased(4 * width, width, device) },
            ls2: LayerScale::new(width, device),
        }
    }

    /// Of tokens `[b, n, c]`: the same shape.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let x = x.clone() + self.ls1.forward(self.attn.forward(self.norm1.forward(x)));
        x.clone() + self.ls2.forward(self.mlp.forward(self.norm2.forward(x)))
    }
}
