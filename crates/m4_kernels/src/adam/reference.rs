//! The definition of one optimiser step.

use super::{AdamParams, FIXED};
use m4_core::Real;

/// One parameter: its new value, first and second moment.
pub fn update<T: Real>(
    x: T,
    g: T,
    m: T,
    v: T,
    count: u32,
    rate: T,
    params: &AdamParams,
) -> (T, T, T) {
    let (beta1, beta2) = (T::of(params.beta1), T::of(params.beta2));
    let m = beta1 * m + (T::one() - beta1) * g;
    let v = beta2 * v + (T::one() - beta2) * g * g;
    let bias = |beta: f64| T::of(1.0 - beta.powf(f64::from(count)));
    let mean = m / bias(params.beta1);
    let root = (v / bias(params.beta2)).sqrt();
    (x - rate * mean / (root + T::of(params.epsilon)), m, v)
}

/// One column: rows with `touched` 0, or `count` [`FIXED`], keep everything. `count` is after this
/// step's increment; all slices have the same length.
pub fn step<T: Real>(
    x: &mut [T],
    g: &[T],
    m: &mut [T],
    v: &mut [T],
    touched: &[u8],
    count: &[u32],
    rate: T,
    params: &AdamParams,
) {
    for i in 0..x.len() {
        if touched[i] != 0 && count[i] != FIXED {
            (x[i], m[i], v[i]) = update(x[i], g[i], m[i], v[i], count[i], rate, params);
        }
    }
}
