//! Multi-head attention that never stores all scores.

use super::activations::{all, changed, exp_parts, keep_nan};
use burn_core::tensor::activation::softmax;
use burn_core::tensor::{Device, Tensor};
use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16};
use rayon::prelude::*;

/// Scores that are held at a time on the processor (16 MB) and elsewhere.
const SCORES: [usize; 2] = [1 << 22, 1 << 26];

/// `softmax(q k^T / sqrt(c)) v` of every head: `q` `[b, heads, n, c]`, `k` `[b, heads, m, c]` and
/// `v` `[b, heads, m, d]` give `[b, heads, n, d]`.
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

const LANES: usize = 16;
/// Numbers of one task, at least a row.
const CHUNK: usize = 1 << 15;

/// `e^x` of every number of `x` `[.., n]`, divided by the sum over the last axis. Sums are made in
/// a fixed order.
pub fn softmax_rows<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    match x.dims()[D - 1] {
        0 => x,
        n => changed(x, |values| on_processor(values, n), |x| softmax(x, D - 1)),
    }
}

fn on_processor(values: &mut [f32], n: usize) {
    let level = Level::new();
    values
        .par_chunks_mut((CHUNK / n).max(1) * n)
        .for_each(|rows| dispatch!(level, s => each(s, rows, n)));
}

#[inline(always)]
fn each<S: Simd>(s: S, rows: &mut [f32], n: usize) {
    for row in rows.chunks_exact_mut(n) {
        let (whole, rest) = row.as_chunks_mut::<LANES>();
        // beyond the row lies what weighs nothing
        let mut last = [f32::NEG_INFINITY; LANES];
        last[..rest.len()].copy_from_slice(rest);
        let mut largest = f32x16::from_slice(s, &last);
        for x in whole.iter() {
            largest = f32x16::from_slice(s, x).max(largest);
        }
        let largest: [f32; LANES] = largest.into();
        let largest = all(s, largest.into_iter().fold(f32::NEG_INFINITY, f32::max));
        let mut sum = all(s, 0.0);
        for x in whole.iter_mut() {
            let e = power(s, f32x16::from_slice(s, x) - largest);
            sum += e;
            *x = e.into();
        }
        let mut ends: [f32; LANES] = power(s, f32x16::from_slice(s, &last) - largest).into();
        ends[rest.len()..].fill(0.0);
        let sum: [f32; LANES] = (sum + f32x16::from_slice(s, &ends)).into();
        let scale = 1.0 / sum.iter().sum::<f32>();
        for x in whole.iter_mut() {
            *x = (f32x16::from_slice(s, x) * all(s, scale)).into();
        }
        for (x, e) in rest.iter_mut().zip(ends) {
            *x = e * scale;
        }
    }
}

/// `e^x` for `x <= 0`.
#[inline(always)]
fn power<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    let (power, rest) = exp_parts(s, x);
    keep_nan(x, power.mul_add(rest, power))
}

#[cfg(test)]
mod tests {
    use super::{attend_heads, softmax_rows};
    use crate::cpu;
    use crate::ops::tensor;
    use burn_core::tensor::Tensor;
    use burn_core::tensor::activation::softmax;
    use m4_testkit::{assert_close, formula_input, same_on_any_threads};

    #[test]
    fn chunked_attention_equals_the_whole() {
        for [b, heads, n, m, c, d] in [[2, 3, 70, 50, 16, 16], [1, 1, 900, 5000, 8, 4]] {
            let input = |key: &str, shape: [usize; 4]| -> Tensor<4> {
                tensor(
                    formula_input(key, 0.0, 2.0, shape.iter().product()),
                    shape,
                    &cpu(),
                )
            };
            let q = input("q", [b, heads, n, c]);
            let (k, v) = (input("k", [b, heads, m, c]), input("v", [b, heads, m, d]));
            let scores = q
                .clone()
                .matmul(k.clone().swap_dims(2, 3))
                .div_scalar((c as f32).sqrt());
            let want: Vec<f32> = softmax(scores, 3)
                .matmul(v.clone())
                .try_into_vec_as()
                .unwrap();
            let got: Vec<f32> = attend_heads(q, k, v).try_into_vec_as().unwrap();
            assert_eq!(got.len(), b * heads * n * d);
            assert_close("attention", &got, &want, 1e-5);
        }
    }

    fn numbers<const D: usize>(x: Tensor<D>) -> Vec<f32> {
        x.try_into_vec_as().unwrap()
    }

    #[test]
    fn agrees_with_burn() {
        for (rows, n) in [(3, 1), (5, 16), (7, 77), (2, 5000), (70, 64)] {
            let x: Tensor<2> = tensor(formula_input("x", 3.0, 30.0, rows * n), [rows, n], &cpu());
            let got = numbers(softmax_rows(x.clone()));
            for (row, (got, want)) in got
                .chunks(n)
                .zip(numbers(softmax(x, 1)).chunks(n))
                .enumerate()
            {
                assert!(
                    (got.iter().sum::<f32>() - 1.0).abs() < 1e-5,
                    "row {row} of {n}"
                );
                for (a, b) in got.iter().zip(want) {
                    assert!(
                        (a - b).abs() <= 2e-6 * b + 1e-30,
                        "row {row} of {n}: {a} for {b}"
                    );
                }
            }
        }
    }

    #[test]
    fn softmax_propagates_nan() {
        let row = |last: f32| {
            let mut values = vec![0.5; 20];
            values[17] = last;
            numbers(softmax_rows(tensor(values, [1, 20], &cpu())))
        };
        assert!(row(f32::NAN).iter().all(|x| x.is_nan()));
        assert!(row(f32::INFINITY)[17].is_nan());
        let without = row(f32::NEG_INFINITY);
        assert!(without[17] < 1e-30 && (without[0] - 1.0 / 19.0).abs() < 1e-7);
    }

    #[test]
    fn rows_do_not_depend_on_threads() {
        let x: Tensor<2> = tensor(formula_input("x", 0.0, 9.0, 400 * 333), [400, 333], &cpu());
        same_on_any_threads(|| numbers(softmax_rows(x.clone())));
    }
}
