//! Products of rows with rows, three by three.

use super::lanes::{BLOCK, Lane, tree};
use m4_math::nalgebra::DMatrix;

/// Partial sums a product has.
const WIDTH: usize = 8;

/// Adds `a b^T` to the lower triangle of `sums`, for two lists of rows whose length is a multiple of three. Of the
/// blocks on the diagonal all nine entries are added.
#[inline(always)]
pub(super) fn outer_products(a: &[Lane], b: &[Lane], sums: &mut DMatrix<f64>) {
    for (i, a) in a.as_chunks::<3>().0.iter().enumerate() {
        for (j, b) in b.as_chunks::<3>().0[..=i].iter().enumerate() {
            let block = three_by_three(a, b);
            for c in 0..3 {
                for r in 0..3 {
                    sums[(3 * i + r, 3 * j + c)] += f64::from(block[r][c]);
                }
            }
        }
    }
}

#[inline(always)]
fn three_by_three(a: &[Lane; 3], b: &[Lane; 3]) -> [[f32; 3]; 3] {
    let mut sums = [[[0.0_f32; WIDTH]; 3]; 3];
    for k in 0..BLOCK / WIDTH {
        let at = k * WIDTH;
        for r in 0..3 {
            for c in 0..3 {
                for l in 0..WIDTH {
                    sums[r][c][l] += a[r][at + l] * b[c][at + l];
                }
            }
        }
    }
    sums.map(|row| row.map(|s| tree(&s)))
}
