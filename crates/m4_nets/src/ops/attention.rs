//! Multi-head attention that never stores all scores.

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

#[cfg(test)]
mod tests {
    use super::attend_heads;
    use crate::cpu;
    use crate::ops::tensor;
    use burn_core::tensor::Tensor;
    use burn_core::tensor::activation::softmax;
    use m4_testkit::formula_input;

    #[test]
    fn chunked_attention_equals_the_whole() {
        for [b, heads, n, m, c, d] in [[2, 3, 70, 50, 16, 16], [1, 1, 900, 5000, 8, 4]] {
            let input = |key: &str, shape: [usize; 4]| -> Tensor<4> {
                tensor(formula_input(key, 0.0, 2.0, shape.iter().product()), shape, &cpu())
            };
            let q = input("q", [b, heads, n, c]);
            let (k, v) = (input("k", [b, heads, m, c]), input("v", [b, heads, m, d]));
            let scores = q.clone().matmul(k.clone().swap_dims(2, 3)).div_scalar((c as f32).sqrt());
            let want: Vec<f32> = softmax(scores, 3).matmul(v.clone()).try_into_vec_as().unwrap();
            let got: Vec<f32> = attend_heads(q, k, v).try_into_vec_as().unwrap();
            assert_eq!(got.len(), b * heads * n * d);
            let largest = want.iter().fold(0.0_f32, |m, x| m.max(x.abs()));
            assert!(largest > 0.01);
            for (a, b) in got.iter().zip(&want) {
                assert!((a - b).abs() < 1e-5 * largest, "{a} for {b}");
            }
        }
    }
}
