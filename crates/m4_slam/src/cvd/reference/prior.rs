//! The term that holds on to what is known already.

use super::{Problem, Term};
use m4_math::Real;

/// `confidence (log(initial) - log(disparity))^2`, mean over all pixels; 0 without confidences. Not in the paper.
#[must_use]
pub fn prior_loss<T: Real>(problem: &Problem<T>, disparity: &[T]) -> Term<T> {
    let mut term = Term::zero(disparity.len());
    let Some(confidence) = &problem.prior_confidence else {
        return term;
    };
    let count = T::of(disparity.len() as f64);
    for i in 0..disparity.len() {
        let off = problem.initial[i].ln() - disparity[i].ln();
        term.value += confidence[i] * off * off / count;
        term.disparity[i] = -T::of(2.0) * confidence[i] * off / (count * disparity[i]);
    }
    term
}
