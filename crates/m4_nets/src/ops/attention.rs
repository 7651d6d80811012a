//! Attention of several heads whose scores are never all held.

use super::softmax_rows;
use burn_core::tensor::{Device, Tensor};

/// Scores that are held at a time on the processor (16 MB) and elsewhere.
const SCORES: [usize; 2] = [1 << 22, 1 << 26];

/// `softmax(q k^T / sqrt(c)) v` of every head: `q` `[b, heads, n, c]`, `k` `[b, heads, m, c]` and `v` `[b, heads, m, d]` give
/// `[b, heads, n, d]`.
pub fn attend_heads(q: Tensor<4>, k: Tensor<4>, v: Tensor<4>) -> Tensor<4> {
    let [_, _, _, c] = q.dims();
    let [b, heads, m, _] = k.dims();
    let q = q.mul_scalar(1.0 / (c as f32).sqrt());
    let k = k.swap_dims(2, 3);
    let most = SCORES[usize::from(q.device() != Device::flex())];
    let rows = (most / (b * heads * m).max(1)).max(32);
    let some = |q: Tensor<4>| softmax_rows(q.matmul(k.clone())).matmul(v.clone());
    Tensor::cat(q.split(rows, 2).into_iter().map(some).collect(), 2)
}
