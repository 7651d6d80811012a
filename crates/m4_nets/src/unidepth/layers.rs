//! Layers of tokens `[n, channels]` that the heads share.

use crate::dinov2::LayerScale;
use crate::ops::{attend_heads, gelu, in_parts, linear, norm};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::softmax;
use burn_core::tensor::{Device, Tensor};
use burn_nn::{LayerNorm, Linear};

/// Heads of the blocks that mix them.
pub const HEADS: usize = 8;
/// Tokens that a feed-forward layer takes at a time.
const TOKENS: usize = 1024;

/// A feed-forward layer, normalised before.
#[derive(Module, Debug)]
pub struct Mlp {
    norm: LayerNorm,
    proj1: Linear,
    proj2: Linear,
}

impl Mlp {
    /// Of `from` channels, through `expansion` times as many, to `to`.
    pub fn new(from: usize, expansion: usize, to: usize, device: &Device) -> Self {
        Self {
            norm: norm(from, device),
            proj1: linear(from, expansion * from, true, device),
            proj2: linear(expansion * from, to, true, device),
        }
    }

    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        in_parts(x, 0, TOKENS, |x| {
            self.proj2
                .forward(gelu(self.proj1.forward(self.norm.forward(x))))
        })
    }
}

/// From the backbone's channels to the heads', one set of weights for each level.
#[derive(Module, Debug)]
pub struct Adapters {
    input_adapters: Vec<Adapter>,
}

/// Named `0` and `1` in the checkpoint.
#[derive(Module, Debug)]
struct Adapter {
    norm: LayerNorm,
    linear: Linear,
}

impl Adapters {
    /// `n` of them.
    pub fn new(n: usize, from: usize, to: usize, device: &Device) -> Self {
        let adapter = |_| Adapter {
            norm: norm(from, device),
            linear: linear(from, to, true, device),
        };
        Self {
            input_adapters: (0..n).map(adapter).collect(),
        }
    }

    /// Each of `levels` by its own.
    pub fn forward(&self, levels: Vec<Tensor<2>>) -> Vec<Tensor<2>> {
        let pairs = self.input_adapters.iter().zip(levels);
        let adapted =
            |(adapter, x): (&Adapter, _)| gelu(adapter.linear.forward(adapter.norm.forward(x)));
        pairs.map(adapted).collect()
    }
}

/// A block: attention, then a feed-forward layer, each normalised before, scaled a channel after,
/// and added.
#[derive(Module, Debug)]
pub struct Block {
    mlp: Mlp,
    kv: Linear,
    q: Linear,
    norm_attnx: LayerNorm,
    norm_attnctx: LayerNorm,
    out: Linear,
    ls1: LayerScale,
    ls2: LayerScale,
}

impl Block {
    pub fn new(width: usize, device: &Device) -> Self {
        let square = || linear(width, width, true, device);
        Self {
            mlp: Mlp::new(width, 4, width, device),
            kv: linear(width, 2 * width, true, device),
            q: square(),
            norm_attnx: norm(width, device),
            norm_attnctx: norm(width, device),
            out: square(),
            ls1: LayerScale::new(width, device),
            ls2: LayerScale::new(width, device),
        }
    }

    /// `x` in the light of `context`, in one head. `q_position` is added to queries, `k_position`
    /// to keys.
    pub fn attending(
        &self,
        x: Tensor<2>,
        context: Tensor<2>,
        q_position: Option<Tensor<2>>,
        k_position: Option<Tensor<2>>,
    ) -> Tensor<2> {
        let [q, k, v] = self.projected(x.clone(), context, q_position, k_position);
        let [q, k, v] = [q, k, v].map(|x| x.unsqueeze::<4>());
        self.added(x, attend_heads(q, k, v).squeeze_dim::<3>(0).squeeze_dim(0))
    }

    /// The heads of each token in the light of each other, `position` added to queries: upstream
    /// hands them to its Nystrom attention in the place of the sequence, so that no token sees
    /// another, and the weights are trained that way. The 128 landmarks are more than the heads,
    /// with which that attention is the common one.
    pub fn mixing_heads(&self, x: Tensor<2>, position: Tensor<2>) -> Tensor<2> {
        let [n, width] = x.dims();
        let c = width / HEADS;
        let projected = self.projected(x.clone(), x.clone(), Some(position), None);
        let [q, k, v] = projected.map(|x| x.reshape([n, HEADS, c]));
        let k = k.mul_scalar(1.0 / (c as f32).sqrt()).swap_dims(1, 2);
        let attention = softmax(q.matmul(k), 2).matmul(v);
        self.added(x, attention.reshape([n, width]))
    }

    fn projected(
        &self,
        x: Tensor<2>,
        context: Tensor<2>,
        q_position: Option<Tensor<2>>,
        k_position: Option<Tensor<2>>,
    ) -> [Tensor<2>; 3] {
        let plus = |x: Tensor<2>, position: Option<Tensor<2>>| match position {
            Some(position) => x + position,
            None => x,
        };
        let q = self.q.forward(self.norm_attnx.forward(x));
        let kv = self.kv.forward(self.norm_attnctx.forward(context));
        let [_, width] = q.dims();
        let (k, v) = (kv.clone().narrow(1, 0, width), kv.narrow(1, width, width));
        [plus(q, q_position), plus(k, k_position), v]
    }

    fn added(&self, x: Tensor<2>, attention: Tensor<2>) -> Tensor<2> {
        let x = self.ls1.forward(self.out.forward(attention)) + x;
        self.ls2.forward(self.mlp.forward(x.clone())) + x
    }
}
