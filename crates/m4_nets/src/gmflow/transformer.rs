//! Each picture's features in the light of the other's (section 3.1): six blocks of self-attention, cross-attention and a
//! feed-forward layer, within windows that every other block moves by half their size.

use super::windows::Windows;
use crate::ops::{gelu, linear, norm};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::softmax;
use burn_core::tensor::{Device, Tensor};
use burn_nn::{LayerNorm, Linear};

/// One head of attention. `mlp` and `norm2` follow cross-attention alone.
#[derive(Module, Debug)]
pub struct Attention {
    q_proj: Linear,
    k_proj: Linear,
    v_proj: Linear,
    merge: Linear,
    norm1: LayerNorm,
    mlp: Option<Mlp>,
    norm2: Option<LayerNorm>,
}

/// The feed-forward layer, on a pixel's features and its message. Named `mlp.0` and `mlp.2` in the checkpoint.
#[derive(Module, Debug)]
pub struct Mlp {
    expand: Linear,
    contract: Linear,
}

/// Tokens that the feed-forward layer takes at a time: its 1,024 channels of them stay in the cache.
const MLP_TOKENS: usize = 1024;

impl Mlp {
    /// Of `[n, l, 2 c]`: `[n, l, c]`.
    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let [n, l, c2] = x.dims();
        let rows = x
            .reshape([n * l, c2])
            .split(MLP_TOKENS, 0)
            .into_iter()
            .map(|x| self.contract.forward(gelu(self.expand.forward(x))))
            .collect();
        Tensor::cat(rows, 0).reshape([n, l, c2 / 2])
    }
}

impl Attention {
    fn new(width: usize, feed_forward: bool, device: &Device) -> Self {
        let square = || linear(width, width, false, device);
        Self {
            q_proj: square(),
            k_proj: square(),
            v_proj: square(),
            merge: square(),
            norm1: norm(width, device),
            mlp: feed_forward.then(|| Mlp {
                expand: linear(2 * width, 8 * width, false, device),
                contract: linear(8 * width, width, false, device),
            }),
            norm2: feed_forward.then(|| norm(width, device)),
        }
    }

    /// Windows `source` `[n, l, c]` with what they find in `target`; `mask` `[n, l, l]` is added to the scores.
    fn forward(&self, source: Tensor<3>, target: Tensor<3>, mask: Option<&Tensor<3>>) -> Tensor<3> {
        let [_, _, c] = source.dims();
        let q = self.q_proj.forward(source.clone()).mul_scalar(1.0 / (c as f32).sqrt());
        let k = self.k_proj.forward(target.clone());
        let v = self.v_proj.forward(target);
        let found = found(q, k, v, mask);
        let message = self.merge.forward(found);
        let mut message = self.norm1.forward(message);
        if let (Some(mlp), Some(norm2)) = (&self.mlp, &self.norm2) {
            message = norm2.forward(mlp.forward(Tensor::cat(vec![source.clone(), message], 2)));
        }
        source + message
    }
}

/// Scores that are held at a time, unless a window alone has more.
const SCORES: usize = 8 << 20;

/// `softmax(q k^T + mask) v` of each window, `[n, l, c]`, some windows at a time.
fn found(q: Tensor<3>, k: Tensor<3>, v: Tensor<3>, mask: Option<&Tensor<3>>) -> Tensor<3> {
    let [n, l, _] = q.dims();
    let group = (SCORES / (l * l)).clamp(1, n);
    let some = |at: usize| {
        let here = |x: &Tensor<3>| x.clone().narrow(0, at, group.min(n - at));
        let scores = here(&q).matmul(here(&k).swap_dims(1, 2));
        let scores = match mask {
            Some(mask) => scores + here(mask),
            None => scores,
        };
        softmax(scores, 2).matmul(here(&v))
    };
    Tensor::cat((0..n).step_by(group).map(some).collect(), 0)
}

/// Self-attention, then cross-attention with the feed-forward layer.
#[derive(Module, Debug)]
pub struct Block {
    self_attn: Attention,
    cross_attn_ffn: Attention,
}

/// The blocks.
#[derive(Module, Debug)]
pub struct Transformer {
    layers: [Block; 6],
}

impl Transformer {
    pub fn new(width: usize, device: &Device) -> Self {
        Self {
            layers: std::array::from_fn(|_| Block {
                self_attn: Attention::new(width, false, device),
                cross_attn_ffn: Attention::new(width, true, device),
            }),
        }
    }

    /// Features of two pictures, `[2, h, w, c]`, each attended to by the other.
    pub fn forward(&self, features: Tensor<4>, windows: Windows) -> Tensor<4> {
        let mask = windows.shift_mask(&features.device());
        let mask = Tensor::cat(vec![mask.clone(), mask], 0);
        let mut features = features;
        for (i, block) in self.layers.iter().enumerate() {
            let shifted = i % 2 == 1;
            let mask = shifted.then_some(&mask);
            let source = windows.split(features, shifted);
            // the other picture's, before this block
            let half = source.dims()[0] as i64 / 2;
            let target = source.clone().roll(&[half], &[0]);
            let source = block.self_attn.forward(source.clone(), source, mask);
            let source = block.cross_attn_ffn.forward(source, target, mask);
            features = windows.merge(source, shifted);
        }
        features
    }
}
