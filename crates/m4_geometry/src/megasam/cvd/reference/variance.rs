//! The scale-invariant term.

use super::{Problem, Term};
use m4_core::Real;

/// The variance of `log(initial) - log(disparity)` within a frame, mean over frames.
#[must_use]
pub fn scale_invariant_loss<T: Real>(problem: &Problem<T>, disparity: &[T]) -> Term<T> {
    let n = problem.width * problem.height;
    let (pixels, frames) = (T::of(n as f64), T::of(problem.frames() as f64));
    let mut term = Term::zero(disparity.len());
    for frame in 0..problem.frames() {
        let range = frame * n..(frame + 1) * n;
        let difference = |i: usize| problem.initial[i].ln() - disparity[i].ln();
        let mean = range.clone().fold(T::zero(), |s, i| s + difference(i)) / pixels;
        for i in range {
            let off = difference(i) - mean;
            term.value += off * off / (pixels * frames);
            term.disparity[i] = -T::of(2.0) * off / (pixels * frames * disparity[i]);
        }
    }
    term
}
