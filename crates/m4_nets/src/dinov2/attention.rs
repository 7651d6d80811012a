//! Self-attention over all tokens, with several heads.

use super::biased;
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::softmax;
use burn_core::tensor::{Device, Tensor};
use burn_nn::Linear;

/// Attention. Queries, keys and values come out of one linear layer.
#[derive(Module, Debug)]
pub struct Attention {
    qkv: Linear,
    proj: Linear,
    heads: usize,
}

/// Queries that are answered at a time: scores are held for them alone.
const QUERIES: usize = 128;

impl Attention {
    pub fn new(width: usize, heads: usize, device: &Device) -> Self {
        Self { qkv: biased(width, 3 * width, device), proj: biased(width, width, device), heads }
    }

    /// Of tokens `[b, n, c]`: the same shape.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let [b, n, c] = x.dims();
        let qkv = self.qkv.forward(x).reshape([b, n, 3, self.heads, c / self.heads]).permute([2, 0, 3, 1, 4]);
        let [q, k, v] = [0, 1, 2].map(|i| qkv.clone().narrow(0, i, 1).squeeze_dim::<4>(0));
        let found = answered(q, k, v).swap_dims(1, 2).reshape([b, n, c]);
        self.proj.forward(found)
    }
}

/// `softmax(q k^T / sqrt(c)) v` of every head, `[b, heads, n, c]`. Holds at most [`QUERIES`]` * n` scores a head at a time.
fn answered(q: Tensor<4>, k: Tensor<4>, v: Tensor<4>) -> Tensor<4> {
    let [_, _, _, c] = q.dims();
    let k = k.mul_scalar(1.0 / (c as f32).sqrt()).swap_dims(2, 3);
    let some = |q: Tensor<4>| softmax(q.matmul(k.clone()), 3).matmul(v.clone());
    Tensor::cat(q.split(QUERIES, 2).into_iter().map(some).collect(), 2)
}
