//! The multi-scale gradient term.

use super::{Problem, Term, sign};
use m4_core::Real;

/// Every which pixel, for each scale. MegaSaM: four scales.
pub(in crate::megasam::cvd) const INTERVALS: [usize; 4] = [1, 2, 4, 8];

/// How much the central differences of `log(initial) - log(disparity)` are, at four scales (each a nearest-exact
/// subsampling): the sum over both directions and all scales of the mean of `weight |difference|`.
///
/// The weight, a constant for the gradient, is `1 - exp(-5 |G(initial) - G(disparity)|)` where the disparity is above 1 and
/// 0 elsewhere; G is the sum of the absolute central differences of the logarithm. So it acts on what is near, where
/// shapes differ. A scale at which an image has less than three pixels a side is left out.
#[must_use]
pub fn gradient_loss<T: Real>(problem: &Problem<T>, disparity: &[T]) -> Term<T> {
    let (width, n) = (problem.width, problem.width * problem.height);
    let mut term = Term::zero(disparity.len());
    for interval in INTERVALS {
        let (w, h) = (problem.width / interval, problem.height / interval);
        if w < 3 || h < 3 {
            continue;
        }
        let count = T::of((problem.frames() * (w - 2) * (h - 2)) as f64);
        for frame in 0..problem.frames() {
            let at =
                |x: usize, y: usize| frame * n + (y * interval + interval / 2) * width + x * interval + interval / 2;
            for y in 1..h - 1 {
                for x in 1..w - 1 {
                    if disparity[at(x, y)] <= T::one() {
                        continue;
                    }
                    let ends = [[at(x - 1, y), at(x + 1, y)], [at(x, y - 1), at(x, y + 1)]];
                    let change = |log: &dyn Fn(usize) -> T| ends.map(|[a, b]| log(a) - log(b));
                    let initial = change(&|i| problem.initial[i].ln());
                    let current = change(&|i| disparity[i].ln());
                    let steep = |g: [T; 2]| g[0].abs() + g[1].abs();
                    let unlike = (steep(initial) - steep(current)).abs();
                    let weight = (T::one() - (-T::of(5.0) * unlike).exp()) / count;
                    for k in 0..2 {
                        let difference = initial[k] - current[k];
                        term.value += weight * difference.abs();
                        let pull = weight * sign(difference);
                        let [a, b] = ends[k];
                        term.disparity[a] -= pull / disparity[a];
                        term.disparity[b] += pull / disparity[b];
                    }
                }
            }
        }
    }
    term
}
