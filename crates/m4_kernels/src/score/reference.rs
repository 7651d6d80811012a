//! The definition of the score in one frame: the sum over the footprint (Minute4D Eq. 9).

use crate::blend::reference::walk;
use crate::ellipse::reference::{Ellipse, Hard};
use m4_core::Real;

/// The score of each of `splats`, which are in order of depth and have these temporal `marginals`.
/// `weight` is `[height][width]`.
pub fn score<T: Real>(
    splats: &[Ellipse<T>],
    marginals: &[T],
    width: usize,
    weight: &[T],
) -> Vec<T> {
    let mut sum = vec![T::zero(); splats.len()];
    for (pixel, &weight) in weight.iter().enumerate() {
        walk::<T, Hard>(splats, pixel % width, pixel / width, |c| {
            sum[c.index] += weight
        });
    }
    for (sum, &marginal) in sum.iter_mut().zip(marginals) {
        *sum *= marginal;
    }
    sum
}
