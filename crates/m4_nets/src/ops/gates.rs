//! The activations of gates. Burn's take exponentials from a library, a number at a time.

use super::lanes::{Function, apply};
use burn_core::tensor::{Tensor, activation};
use fearless_simd::{Simd, f32x16, prelude::*, u32x16};

/// `1 / (1 + e^-x)` of every number, within 1e-6 of itself where that is above 1e-30.
pub fn sigmoid<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    apply::<Sigmoid, D>(x, activation::sigmoid)
}

/// The hyperbolic tangent of every number, within 1e-6 of itself.
pub fn tanh<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    apply::<Tanh, D>(x, Tensor::tanh)
}

pub(super) struct Sigmoid;

impl Function for Sigmoid {
    #[inline(always)]
    fn lanes<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
        let one = all(s, 1.0);
        // e^-|x| is at most 1: no overflow
        let (power, rest) = exp_parts(s, -x.abs());
        let e = power.mul_add(rest, power);
        let less = x.simd_lt(all(s, 0.0));
        keep_nan(x, less.select(e, one) / (one + e))
    }
}

struct Tanh;

impl Function for Tanh {
    #[inline(always)]
    fn lanes<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
        // tanh |x| = -t / (2 + t) with t = e^(-2 |x|) - 1
        let (power, rest) = exp_parts(s, x.abs() * all(s, -2.0));
        let t = power.mul_add(rest, power - all(s, 1.0));
        keep_nan(x, (-t / (all(s, 2.0) + t)).copysign(x))
    }
}

#[inline(always)]
pub(super) fn all<S: Simd>(s: S, value: f32) -> f32x16<S> {
    f32x16::splat(s, value)
}

#[inline(always)]
pub(super) fn keep_nan<S: Simd>(x: f32x16<S>, y: f32x16<S>) -> f32x16<S> {
    x.simd_eq(x).select(y, x)
}

/// `e^x` for `x <= 0` as `p (1 + r)` with a power of two `p`: both, so that `e^x - 1` loses nothing near 0. Saturates at -80.
#[inline(always)]
pub(super) fn exp_parts<S: Simd>(s: S, x: f32x16<S>) -> (f32x16<S>, f32x16<S>) {
    let x = x.max(all(s, -80.0));
    // adding 1.5 * 2^23 leaves the rounded number in the low bits of the mantissa
    let magic = all(s, 12_582_912.0);
    let shifted = x.mul_add(all(s, std::f32::consts::LOG2_E), magic);
    let k = shifted - magic;
    // ln 2 in two parts
    let f = k.mul_add(all(s, -1.428_606_8e-6), k.mul_add(all(s, -0.693_145_75), x));
    let mut p = all(s, 1.0 / 5040.0);
    for c in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0] {
        p = p.mul_add(f, all(s, c));
    }
    let exponent: u32x16<S> = shifted.to_bits();
    let one: u32x16<S> = all(s, 1.0).to_bits();
    (f32x16::from_bits(one + (exponent << 23u32)), p * f)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu;
    use crate::ops::tensor;

    fn of(f: impl Fn(Tensor<1>) -> Tensor<1>, xs: &[f32]) -> Vec<f32> {
        let x = tensor(xs.to_vec(), [xs.len()], &cpu());
        f(x).try_into_vec_as().unwrap()
    }

    #[test]
    fn agree_with_their_definitions() {
        let n = 50_003;
        let xs: Vec<f32> =
            (0..n).map(|i| (i as f32 / n as f32 - 0.5) * 40.0).chain((0..40).map(|k| 0.7_f32.powi(k))).collect();
        let pairs = [(of(sigmoid, &xs), (|x| 1.0 / (1.0 + (-x).exp())) as fn(f64) -> f64), (of(tanh, &xs), f64::tanh)];
        for (got, want) in pairs {
            for (&x, got) in xs.iter().zip(got) {
                let want = want(f64::from(x));
                let error = (f64::from(got) - want).abs();
                assert!(error <= 1e-6 * want.abs(), "{x}: {got} where {want} was expected");
            }
        }
    }

    #[test]
    fn gates_of_extreme_inputs_stay_within_bounds() {
        let xs = [f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, 0.0, -0.0, f32::NAN];
        let got = of(tanh, &xs);
        assert_eq!(got[..6], [1.0, -1.0, 1.0, -1.0, 0.0, -0.0]);
        assert!(got[6].is_nan());
        let got = of(sigmoid, &xs);
        assert!(got[0] == 1.0 && got[2] == 1.0 && got[4] == 0.5 && got[5] == 0.5 && got[6].is_nan());
        assert!(got[1] < 1e-30 && got[3] < 1e-30 && got[1] >= 0.0, "{got:?}");
    }
}
