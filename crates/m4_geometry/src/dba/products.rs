//! Inner products of rows, one or three by three, in vectors of the machine's width.

use super::lanes::Lane;
use fearless_simd::{Simd, prelude::*};
use m4_core::nalgebra::DMatrix;

/// Adds `a b^T` to the lower triangle of `sums`, for two lists of rows whose length is a multiple of three. Of the
/// blocks on the diagonal all nine entries are added.
#[inline(always)]
pub(super) fn outer_products<S: Simd>(s: S, a: &[Lane], b: &[Lane], sums: &mut DMatrix<f64>) {
    for (i, a) in a.as_chunks::<3>().0.iter().enumerate() {
        for (j, b) in b.as_chunks::<3>().0[..=i].iter().enumerate() {
            let block = three_by_three(s, a.each_ref(), b.each_ref());
            for c in 0..3 {
                for r in 0..3 {
                    sums[(3 * i + r, 3 * j + c)] += f64::from(block[r][c]);
                }
            }
        }
    }
}

/// The nine inner products of three rows with three: nine sums and the six vectors they come from fit into sixteen
/// registers.
#[inline(always)]
pub(super) fn three_by_three<S: Simd, const N: usize>(s: S, a: [&[f32; N]; 3], b: [&[f32; N]; 3]) -> [[f32; 3]; 3] {
    let width = S::f32s::LEN;
    let zero = S::f32s::splat(s, 0.0);
    let ([mut s00, mut s01, mut s02], [mut s10, mut s11, mut s12], [mut s20, mut s21, mut s22]) =
        ([zero; 3], [zero; 3], [zero; 3]);
    for k in (0..N).step_by(width) {
        let (b0, b1, b2) = (vector(s, b[0], k), vector(s, b[1], k), vector(s, b[2], k));
        let x = vector(s, a[0], k);
        (s00, s01, s02) = (x.mul_add(b0, s00), x.mul_add(b1, s01), x.mul_add(b2, s02));
        let x = vector(s, a[1], k);
        (s10, s11, s12) = (x.mul_add(b0, s10), x.mul_add(b1, s11), x.mul_add(b2, s12));
        let x = vector(s, a[2], k);
        (s20, s21, s22) = (x.mul_add(b0, s20), x.mul_add(b1, s21), x.mul_add(b2, s22));
    }
    // Written out: closures do not inherit the instruction set.
    [
        [s00.reduce_sum(), s01.reduce_sum(), s02.reduce_sum()],
        [s10.reduce_sum(), s11.reduce_sum(), s12.reduce_sum()],
        [s20.reduce_sum(), s21.reduce_sum(), s22.reduce_sum()],
    ]
}

/// The inner product of two rows.
#[inline(always)]
pub(super) fn dot<S: Simd, const N: usize>(s: S, a: &[f32; N], b: &[f32; N]) -> f64 {
    let width = S::f32s::LEN;
    let zero = S::f32s::splat(s, 0.0);
    let (mut even, mut odd) = (zero, zero);
    for k in (0..N).step_by(2 * width) {
        even = vector(s, a, k).mul_add(vector(s, b, k), even);
        odd = vector(s, a, k + width).mul_add(vector(s, b, k + width), odd);
    }
    f64::from((even + odd).reduce_sum())
}

#[inline(always)]
fn vector<S: Simd, const N: usize>(s: S, row: &[f32; N], at: usize) -> S::f32s {
    S::f32s::from_slice(s, &row[at..at + S::f32s::LEN])
}
