//! What settings may be.

use crate::dense::DenseError;

/// [`DenseError::Setting`] unless `ok`.
pub(in crate::dense) fn need(ok: bool, name: &'static str, value: f64, range: &str) -> Result<(), DenseError> {
    if ok {
        Ok(())
    } else {
        let range = range.to_owned();
        Err(DenseError::Setting { name, value, range })
    }
}

/// Numbers that must be finite and above 0.
pub(super) fn above_zero(all: &[(&'static str, f64)]) -> Result<(), DenseError> {
    all.iter()
        .try_for_each(|&(name, v)| need(v > 0.0 && v.is_finite(), name, v, "a number above 0"))
}

/// Numbers of 0 to 1.
pub(in crate::dense) fn shares(all: &[(&'static str, f64)]) -> Result<(), DenseError> {
    all.iter()
        .try_for_each(|&(name, v)| need((0.0..=1.0).contains(&v), name, v, "0 to 1"))
}

/// Whole numbers with the least and the most that they may be.
pub(in crate::dense) fn whole(all: &[(&'static str, usize, usize, usize)]) -> Result<(), DenseError> {
    all.iter().try_for_each(|&(name, v, least, most)| {
        let good = (least..=most).contains(&v);
        need(good, name, v as f64, &format!("{least} to {most}"))
    })
}
