//! The definition of the photometric loss and its gradient.

use super::{SSIM_C1, SSIM_C2, WINDOW, window};
use m4_core::Real;

/// One pass of the window along rows (`step` 1) or columns (`step` = width), zero padded.
fn blur_axis<T: Real>(x: &[T], width: usize, height: usize, along_rows: bool) -> Vec<T> {
    let taps = window().map(T::of);
    let half = WINDOW / 2;
    let (length, step) = if along_rows {
        (width, 1)
    } else {
        (height, width)
    };
    (0..x.len())
        .map(|i| {
            let position = if along_rows { i % width } else { i / width };
            let mut sum = T::zero();
            for (k, &tap) in taps.iter().enumerate() {
                // the tap lies at position + k - half, inside only where 0 <= that < length
                if position + k >= half && position + k < length + half {
                    sum += tap * x[i + k * step - half * step];
                }
            }
            sum
        })
        .collect()
}

/// The window along both axes of a plane, zero padded. It is its own transpose.
pub fn blur<T: Real>(x: &[T], width: usize, height: usize) -> Vec<T> {
    blur_axis(&blur_axis(x, width, height, true), width, height, false)
}

/// Mean SSIM of two planes, `[height][width]`, and its gradient with respect to `x`.
pub fn ssim<T: Real>(x: &[T], y: &[T], width: usize, height: usize) -> (T, Vec<T>) {
    let product = |a: &[T], b: &[T]| -> Vec<T> { a.iter().zip(b).map(|(&a, &b)| a * b).collect() };
    let blur = |x: &[T]| blur(x, width, height);
    let (mean_x, mean_y) = (blur(x), blur(y));
    let (xx, yy, xy) = (
        blur(&product(x, x)),
        blur(&product(y, y)),
        blur(&product(x, y)),
    );
    let (c1, c2, two) = (T::of(SSIM_C1), T::of(SSIM_C2), T::of(2.0));

    let n = x.len();
    let mut sum = T::zero();
    // derivatives with respect to blur x, blur x^2 and blur xy
    let (mut d_mean, mut d_square, mut d_product) =
        (vec![T::zero(); n], vec![T::zero(); n], vec![T::zero(); n]);
    for i in 0..n {
        let (a, b) = (mean_x[i], mean_y[i]);
        let (n1, n2) = (two * a * b + c1, two * (xy[i] - a * b) + c2);
        let (d1, d2) = (a * a + b * b + c1, (xx[i] - a * a) + (yy[i] - b * b) + c2);
        let s = n1 * n2 / (d1 * d2);
        sum += s;
        d_square[i] = -s / d2;
        d_product[i] = two * n1 / (d1 * d2);
        d_mean[i] =
            two * b * n2 / (d1 * d2) - two * a * s / d1 - two * a * d_square[i] - b * d_product[i];
    }
    let count = T::of(n.max(1) as f64);
    let (d_mean, d_square, d_product) = (blur(&d_mean), blur(&d_square), blur(&d_product));
    let gradient = (0..n)
        .map(|i| (d_mean[i] + two * x[i] * d_square[i] + y[i] * d_product[i]) / count)
        .collect();
    (sum / count, gradient)
}

/// The loss of image `x` against `y`, one plane per channel, and its gradient with respect to `x`.
/// `lambda` is the share of SSIM, 0..=1. An image without pixels has loss 0.
pub fn photometric<T: Real>(
    x: [&[T]; 3],
    y: [&[T]; 3],
    width: usize,
    height: usize,
    lambda: T,
) -> (T, [Vec<T>; 3]) {
    if width * height == 0 {
        return (T::zero(), Default::default());
    }
    let three = T::of(3.0);
    let count = T::of((3 * width * height) as f64);
    let share = T::one() - lambda;
    let mut loss = T::zero();
    let gradient = std::array::from_fn(|c| {
        let (similarity, d_similarity) = ssim(x[c], y[c], width, height);
        loss += lambda * (T::one() - similarity) / three;
        let mut d = d_similarity;
        for (d, (&x, &y)) in d.iter_mut().zip(x[c].iter().zip(y[c])) {
            let difference = x - y;
            loss += share * difference.abs() / count;
            let sign = if difference > T::zero() {
                T::one()
            } else if difference < T::zero() {
                -T::one()
            } else {
                T::zero()
            };
            *d = share * sign / count - lambda * *d / three;
        }
        d
    });
    (loss, gradient)
}
