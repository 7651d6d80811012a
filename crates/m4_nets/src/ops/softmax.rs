//! Weights of attention, with vector instructions where tensors lie on the processor.
//!
//! Burn's takes exponentials from a library, a number at a time, and writes to new memory.

use super::gates::{all, exp_parts, keep_nan};
use burn_core::tensor::activation::softmax;
use burn_core::tensor::{Device, Tensor, TensorData};
use fearless_simd::{Level, Simd, dispatch, f32x16, prelude::*};
use rayon::prelude::*;

const LANES: usize = 16;
/// Numbers of one task, at least a row.
const CHUNK: usize = 1 << 15;

/// `e^x` of every number of `x` `[.., n]`, divided by the sum over the last axis. Sums are made in a fixed order.
pub fn softmax_rows<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    let device = x.device();
    let n = x.dims()[D - 1];
    if device != Device::flex() || n == 0 {
        return softmax(x, D - 1);
    }
    let mut data: TensorData = x.into_data();
    match data.as_mut_slice::<f32>() {
        Ok(values) => {
            on_processor(values, n);
            Tensor::from_data(data, &device)
        }
        Err(_) => {
            let dtype = data.dtype();
            softmax(Tensor::from_data(data, (&device, dtype)), D - 1)
        }
    }
}

fn on_processor(values: &mut [f32], n: usize) {
    let level = Level::new();
    values.par_chunks_mut((CHUNK / n).max(1) * n).for_each(|rows| dispatch!(level, s => each(s, rows, n)));
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
    use super::softmax_rows;
    use crate::cpu;
    use crate::ops::tensor;
    use burn_core::tensor::Tensor;
    use burn_core::tensor::activation::softmax;
    use m4_testkit::formula_input;

    fn numbers<const D: usize>(x: Tensor<D>) -> Vec<f32> {
        x.try_into_vec_as().unwrap()
    }

    #[test]
    fn agrees_with_burn() {
        for (rows, n) in [(3, 1), (5, 16), (7, 77), (2, 5000), (70, 64)] {
            let x: Tensor<2> = tensor(formula_input("x", 3.0, 30.0, rows * n), [rows, n], &cpu());
            let got = numbers(softmax_rows(x.clone()));
            for (row, (got, want)) in got.chunks(n).zip(numbers(softmax(x, 1)).chunks(n)).enumerate() {
                assert!((got.iter().sum::<f32>() - 1.0).abs() < 1e-5, "row {row} of {n}");
                for (a, b) in got.iter().zip(want) {
                    assert!((a - b).abs() <= 2e-6 * b + 1e-30, "row {row} of {n}: {a} for {b}");
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
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| numbers(softmax_rows(x.clone())))
        };
        assert_eq!(with(1), with(3));
    }
}
