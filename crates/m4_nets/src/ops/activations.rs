//! Functions of one number, with vector instructions where tensors lie on the processor.

use burn_core::tensor::{Device, Tensor, TensorData, activation};
use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16, u32x16};
use rayon::prelude::*;

const CHUNK: usize = 1 << 15;
const LANES: usize = 16;

/// A function of one number.
pub trait Function {
    /// Of 16 numbers.
    fn lanes<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S>;
}

/// `x` changed by `change` where its numbers are of 32 bits on the processor, else `otherwise` of
/// it.
pub fn changed<const D: usize>(
    x: Tensor<D>,
    change: impl Fn(&mut [f32]),
    otherwise: impl Fn(Tensor<D>) -> Tensor<D>,
) -> Tensor<D> {
    let device = x.device();
    if device != Device::flex() {
        return otherwise(x);
    }
    let mut data: TensorData = x.into_data();
    match data.as_mut_slice::<f32>() {
        Ok(values) => {
            change(values);
            Tensor::from_data(data, &device)
        }
        Err(_) => {
            let dtype = data.dtype();
            otherwise(Tensor::from_data(data, (&device, dtype)))
        }
    }
}

fn on_processor<F: Function>(values: &mut [f32]) {
    let level = Level::new();
    values
        .par_chunks_mut(CHUNK)
        .for_each(|chunk| dispatch!(level, s => each::<_, F>(s, chunk)));
}

#[inline(always)]
fn each<S: Simd, F: Function>(s: S, values: &mut [f32]) {
    let (whole, rest) = values.as_chunks_mut::<LANES>();
    for x in whole {
        *x = F::lanes(s, f32x16::from_slice(s, x)).into();
    }
    if !rest.is_empty() {
        let mut last = [0.0; LANES];
        last[..rest.len()].copy_from_slice(rest);
        let last: [f32; LANES] = F::lanes(s, f32x16::from_slice(s, &last)).into();
        rest.copy_from_slice(&last[..rest.len()]);
    }
}

/// `1 / (1 + e^-x)` of every number, within 1e-6 of itself where that is above 1e-30.
pub fn sigmoid<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    changed(x, on_processor::<Sigmoid>, activation::sigmoid)
}

/// The hyperbolic tangent of every number, within 1e-6 of itself.
pub fn tanh<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    changed(x, on_processor::<Tanh>, Tensor::tanh)
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

/// `e^x` for `x <= 0` as `p (1 + r)` with a power of two `p`: both, so that `e^x - 1` loses nothing
/// near 0. Saturates at -80.
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

/// Burn's own GELU takes `erf` from a library, a number at a time: 38% of the time of a network
/// that was measured. Here `erf(x)` is `x P(x^2) / Q(x^2)` on [-4, 4], beyond which it is 1 in 32
/// bits (the coefficients that Eigen and XLA use); `P`, the highest power first.
const P: [f32; 7] = [
    -2.726_142_3e-10,
    2.770_681_4e-8,
    -2.101_024e-6,
    -5.692_506_5e-5,
    -7.349_906_5e-4,
    -2.954_6e-3,
    -1.609_603_3e-2,
];
/// `Q`, the highest power first.
const Q: [f32; 5] = [
    -1.456_607_2e-5,
    -2.133_740_6e-4,
    -1.682_827e-3,
    -7.373_329e-3,
    -1.426_474e-2,
];
/// `x Phi(x)` of every number, where `Phi` is the normal distribution; within 1e-6 of its
/// definition, relative to `1 + |x|`.
pub fn gelu<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    changed(x, on_processor::<Gelu>, activation::gelu)
}

/// What is trained instead of it at times, `x (1 + tanh(sqrt(2 / pi) (x + 0.044715 x^3))) / 2` of
/// every number; within 2e-6 of its definition, relative to `1 + |x|`.
pub fn gelu_by_tanh<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    changed(x, on_processor::<GeluByTanh>, |x| {
        let square = x.clone() * x.clone();
        let cubic = square.mul_scalar(CUBIC).add_scalar(1.0) * x.clone();
        x * activation::sigmoid(cubic.mul_scalar(SLOPE))
    })
}

/// `2 sqrt(2 / pi)`: `(1 + tanh y) / 2` is the logistic function of `2 y`.
const SLOPE: f32 = 1.595_769;
const CUBIC: f32 = 0.044_715;

struct GeluByTanh;

impl Function for GeluByTanh {
    #[inline(always)]
    fn lanes<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
        let all = |value: f32| f32x16::splat(s, value);
        let cubic = (x * x).mul_add(all(CUBIC), all(1.0)) * x;
        x * Sigmoid::lanes(s, cubic * all(SLOPE))
    }
}

struct Gelu;

impl Function for Gelu {
    #[inline(always)]
    fn lanes<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
        let all = |value: f32| f32x16::splat(s, value);
        let half = x * all(0.5);
        let z = (x * all(std::f32::consts::FRAC_1_SQRT_2))
            .min(all(4.0))
            .max(all(-4.0));
        let square = z * z;
        let mut p = all(P[0]);
        for &c in &P[1..] {
            p = p.mul_add(square, all(c));
        }
        let mut q = all(Q[0]);
        for &c in &Q[1..] {
            q = q.mul_add(square, all(c));
        }
        (z * p / q).mul_add(half, half)
    }
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
        let xs: Vec<f32> = (0..n)
            .map(|i| (i as f32 / n as f32 - 0.5) * 40.0)
            .chain((0..40).map(|k| 0.7_f32.powi(k)))
            .collect();
        let pairs = [
            (
                of(sigmoid, &xs),
                (|x| 1.0 / (1.0 + (-x).exp())) as fn(f64) -> f64,
            ),
            (of(tanh, &xs), f64::tanh),
        ];
        for (got, want) in pairs {
            for (&x, got) in xs.iter().zip(got) {
                let want = want(f64::from(x));
                let error = (f64::from(got) - want).abs();
                assert!(
                    error <= 1e-6 * want.abs(),
                    "{x}: {got} where {want} was expected"
                );
            }
        }
    }

    #[test]
    fn gates_of_extreme_inputs_stay_within_bounds() {
        let xs = [
            f32::INFINITY,
            f32::NEG_INFINITY,
            1e30,
            -1e30,
            0.0,
            -0.0,
            f32::NAN,
        ];
        let got = of(tanh, &xs);
        assert_eq!(got[..6], [1.0, -1.0, 1.0, -1.0, 0.0, -0.0]);
        assert!(got[6].is_nan());
        let got = of(sigmoid, &xs);
        assert!(
            got[0] == 1.0 && got[2] == 1.0 && got[4] == 0.5 && got[5] == 0.5 && got[6].is_nan()
        );
        assert!(got[1] < 1e-30 && got[3] < 1e-30 && got[1] >= 0.0, "{got:?}");
    }

    /// `erf` by its Taylor series in f64, which is exact enough up to 5.
    fn erf(x: f64) -> f64 {
        let (mut term, mut sum) = (x, x);
        for n in 1..200 {
            term *= -x * x / f64::from(n);
            sum += term / f64::from(2 * n + 1);
        }
        sum * std::f64::consts::FRAC_2_SQRT_PI
    }

    #[test]
    fn gelus_agree_with_their_definitions() {
        assert!((erf(1.0) - 0.842_700_792_949_714_9).abs() < 1e-15);
        let xs: Vec<f32> = (0..70_003)
            .map(|i| (i as f32 / 70_003.0 - 0.5) * 14.0)
            .collect();
        let exact = |x: f64| match x / std::f64::consts::SQRT_2 {
            z if z.abs() < 4.5 => 0.5 * x * (1.0 + erf(z)),
            z => 0.5 * x * (1.0 + z.signum()),
        };
        let by_tanh = |x: f64| {
            0.5 * x
                * (1.0 + ((2.0 / std::f64::consts::PI).sqrt() * (x + 0.044_715 * x * x * x)).tanh())
        };
        let check = |got: Vec<f32>, want: &dyn Fn(f64) -> f64, limit: f64| {
            for (x, got) in xs.iter().map(|&x| f64::from(x)).zip(got) {
                let want = want(x);
                assert!(
                    (f64::from(got) - want).abs() < limit * (1.0 + x.abs()),
                    "{x}: {got}, not {want}"
                );
            }
        };
        check(of(gelu, &xs), &exact, 1e-6);
        check(of(gelu_by_tanh, &xs), &by_tanh, 2e-6);
    }

    #[test]
    fn gelus_of_extreme_inputs_have_their_limits() {
        let xs = [0.0, -0.0, f32::INFINITY, 1e30, -1e30, f32::NAN];
        for (got, far) in [(of(gelu, &xs), 1e24), (of(gelu_by_tanh, &xs), 1.0)] {
            assert_eq!(got[..3], [0.0, 0.0, f32::INFINITY]);
            assert!(
                (got[3] - 1e30).abs() < 1e24 && got[4].abs() < far,
                "{got:?}"
            );
            assert!(got[5].is_nan());
        }
    }
}
