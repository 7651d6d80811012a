//! The pixels whose error is large enough to count (Minute4D Eq. 7, Minute4D Eq. 8).

use crate::config::ErrorRange;

/// Sets every error of a frame whose normalised value is not above `threshold` to 0; the others keep
/// their raw value.
///
/// `errors` is one plane, `[height][width]`, of channel-mean absolute errors. Values that are not
/// finite count as 0. A frame without any difference between its errors has no pixel that counts.
pub fn masked_error(errors: &mut [f32], threshold: f32, range: ErrorRange) {
    for e in errors.iter_mut().filter(|e| !e.is_finite()) {
        *e = 0.0;
    }
    let (low, high) = match range {
        ErrorRange::MinMax => errors.iter().fold((f32::INFINITY, 0.0f32), |(a, b), &e| (a.min(e), b.max(e))),
        ErrorRange::Quantile { high } => (0.0, quantile(errors, high)),
    };
    let cut = low + threshold * (high - low);
    for e in errors.iter_mut() {
        if high <= low || *e <= cut {
            *e = 0.0;
        }
    }
}

/// The value below which a share `q` of `values` lies; 0 for none.
pub(crate) fn quantile(values: &[f32], q: f32) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let mut sorted = values.to_vec();
    let k = ((values.len() - 1) as f32 * q.clamp(0.0, 1.0)) as usize;
    *sorted.select_nth_unstable_by(k.min(values.len() - 1), f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::{masked_error, quantile};
    use crate::config::ErrorRange;

    #[test]
    fn small_errors_do_not_count() {
        let mut errors = vec![0.1, 0.12, 0.3, 0.2, 1.1];
        masked_error(&mut errors, 0.1, ErrorRange::MinMax);
        // cut at 0.1 + 0.1 * 1.0
        assert_eq!(errors, [0.0, 0.0, 0.3, 0.0, 1.1]);
        let mut flat = vec![0.2; 9];
        masked_error(&mut flat, 0.1, ErrorRange::MinMax);
        assert!(flat.iter().all(|&e| e == 0.0));
    }

    #[test]
    fn one_hot_pixel_does_not_hide_the_others() {
        let base: Vec<f32> = (0..1000).map(|i| if i == 7 { 50.0 } else { (i % 10) as f32 * 0.01 }).collect();
        let kept = |range| {
            let mut e = base.clone();
            masked_error(&mut e, 0.1, range);
            e.iter().filter(|e| **e > 0.0).count()
        };
        assert_eq!(kept(ErrorRange::MinMax), 1);
        assert!(kept(ErrorRange::Quantile { high: 0.995 }) > 700);
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), 2.0);
        assert_eq!(quantile(&[], 0.5), 0.0);
    }
}
