//! The partial convolution of DyCheck's masked SSIM (`compute_ssim` of its `dycheck/core/metrics/image.py`).

use super::window::Window;
use m4_core::Mask;

/// Weighted means of those `values` `[height][width]` that are in `mask` (all of them without one), where the window lies wholly
/// inside: along rows, then along columns. Each sum is multiplied by the number of taps over how many of them are in the mask,
/// *not* by the weights that are; 0 where none is. After the first pass a place is in the mask if any of its taps was.
pub fn filtered(values: &[f64], mask: Option<&Mask>, width: usize, height: usize, window: &Window) -> Vec<f64> {
    let (out_w, out_h) = (width + 1 - window.side(), height + 1 - window.side());
    let kept: Vec<bool> = match mask {
        Some(mask) => mask.data().iter().map(|&m| m != 0).collect(),
        None => vec![true; values.len()],
    };
    let (mut rows, mut rows_kept) = (vec![0.0; out_w * height], vec![false; out_w * height]);
    for y in 0..height {
        for x in 0..out_w {
            let taps = y * width + x..y * width + x + window.side();
            (rows[y * out_w + x], rows_kept[y * out_w + x]) = mean(taps.map(|i| (values[i], kept[i])), window);
        }
    }
    let mut out = vec![0.0; out_w * out_h];
    for y in 0..out_h {
        for x in 0..out_w {
            let taps = (y..y + window.side()).map(|y| y * out_w + x);
            (out[y * out_w + x], _) = mean(taps.map(|i| (rows[i], rows_kept[i])), window);
        }
    }
    out
}

/// The renormalised sum, and whether anything was in the mask.
fn mean(values: impl Iterator<Item = (f64, bool)>, window: &Window) -> (f64, bool) {
    let (mut sum, mut count) = (0.0, 0usize);
    for ((value, kept), weight) in values.zip(window.taps()) {
        if kept {
            sum += weight * value;
            count += 1;
        }
    }
    if count == 0 {
        return (0.0, false);
    }
    (sum * window.side() as f64 / count as f64, true)
}

/// Variances and covariance as they can be: renormalised means of squares need not be above the squares of means.
pub fn possible([va, vb, cov]: [f64; 3]) -> [f64; 3] {
    let (va, vb) = (va.max(0.0), vb.max(0.0));
    [va, vb, cov.abs().min((va * vb).sqrt()).copysign(cov)]
}
