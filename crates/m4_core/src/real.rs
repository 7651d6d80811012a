//! The scalar that every reference kernel is generic over, and order statistics of it.

use nalgebra::RealField;
use std::cmp::Ordering;

/// `f32` or `f64`.
///
/// The reference kernels are written once over this trait: in `f64` they are the oracle, in `f32`
/// they show what rounding alone costs.
pub trait Real: RealField + Copy + Default + Send + Sync + 'static {
    /// The nearest value to `x`.
    fn of(x: f64) -> Self;
    /// This value as `f64`, exact.
    fn f64(self) -> f64;
    /// The total order of IEEE 754.
    fn order(&self, other: &Self) -> Ordering;
}

impl Real for f32 {
    fn of(x: f64) -> Self {
        x as f32
    }

    fn f64(self) -> f64 {
        f64::from(self)
    }

    fn order(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}

impl Real for f64 {
    fn of(x: f64) -> Self {
        x
    }

    fn f64(self) -> f64 {
        self
    }

    fn order(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}

/// Returns the value of the nearest rank below which a share `q` (0..=1) of `values` lies; `None`
/// if there are none. Reorders `values`.
pub fn quantile<T: Real>(values: &mut [T], q: f64) -> Option<T> {
    let last = values.len().checked_sub(1)?;
    let rank = (q * last as f64).round() as usize;
    Some(*values.select_nth_unstable_by(rank.min(last), T::order).1)
}

/// Returns the middle value, the upper one of two; `None` if there are none. Reorders `values`.
pub fn median<T: Real>(values: &mut [T]) -> Option<T> {
    quantile(values, 0.5)
}

/// Returns the indices of `count` evenly spaced ones of `n` things, the first and the last among
/// them; of all of them for `None`.
pub fn evenly(n: usize, count: Option<usize>) -> Vec<usize> {
    match count {
        Some(1) if n > 0 => vec![0],
        Some(k) if k < n => (0..k)
            .map(|i| (i * (n - 1) + (k - 1) / 2) / (k - 1))
            .collect(),
        _ => (0..n).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::{evenly, median, quantile};

    #[test]
    fn quantiles_are_values_of_the_nearest_rank() {
        let values = [4.0_f32, 1.0, 3.0, 2.0];
        assert_eq!(
            [0.0, 0.3, 0.9, 1.0].map(|q| quantile(&mut values.clone(), q)),
            [1.0, 2.0, 4.0, 4.0].map(Some)
        );
        for n in 1..9 {
            let mut values: Vec<f64> = (0..n).rev().map(f64::from).collect();
            assert_eq!(median(&mut values), Some(f64::from(n / 2)), "{n}");
        }
        assert_eq!(median::<f64>(&mut []), None);
    }

    #[test]
    fn kept_frames_span_the_clip_evenly() {
        assert_eq!(evenly(10, Some(4)), [0, 3, 6, 9]);
        assert_eq!(evenly(96, Some(2)), [0, 95]);
        assert_eq!(evenly(3, Some(9)), [0, 1, 2]);
        assert_eq!(evenly(5, Some(1)), [0]);
        for k in 2..50 {
            let picked = evenly(50, Some(k));
            assert_eq!((picked.len(), picked[0], picked[k - 1]), (k, 0, 49));
            let steps: Vec<usize> = picked.windows(2).map(|w| w[1] - w[0]).collect();
            assert!(
                steps.iter().max().unwrap() - steps.iter().min().unwrap() <= 1,
                "{k}: {steps:?}"
            );
        }
    }
}
