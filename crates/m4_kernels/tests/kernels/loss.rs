//! The photometric loss: against a direct two-dimensional convolution, and its gradient against
//! differences.

use m4_core::CounterRng;
use m4_kernels::loss::{
    SSIM_C1, SSIM_C2, WINDOW, WINDOW_SD,
    reference::{photometric, ssim},
};
use m4_testkit::{assert_gradient, central_differences};

fn plane(index: u64, n: usize) -> Vec<f64> {
    let mut rng = CounterRng::new(5, 1, index);
    (0..n).map(|_| rng.uniform()).collect()
}

/// SSIM as Wang et al. write it: a sum over the whole two-dimensional window at each pixel, zeros
/// outside the image.
fn direct_ssim(x: &[f64], y: &[f64], width: usize, height: usize) -> f64 {
    let half = (WINDOW / 2) as isize;
    let raw = |i: isize, j: isize| (-((i * i + j * j) as f64) / (2.0 * WINDOW_SD * WINDOW_SD)).exp();
    let norm: f64 = (-half..=half).flat_map(|i| (-half..=half).map(move |j| raw(i, j))).sum();
    let at = |p: &[f64], u: isize, v: isize| {
        if u < 0 || v < 0 || u >= width as isize || v >= height as isize {
            0.0
        } else {
            p[v as usize * width + u as usize]
        }
    };
    let mut sum = 0.0;
    for v in 0..height as isize {
        for u in 0..width as isize {
            let (mut mx, mut my, mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for i in -half..=half {
                for j in -half..=half {
                    let w = raw(i, j) / norm;
                    let (a, b) = (at(x, u + i, v + j), at(y, u + i, v + j));
                    mx += w * a;
                    my += w * b;
                    xx += w * a * a;
                    yy += w * b * b;
                    xy += w * a * b;
                }
            }
            sum += (2.0 * mx * my + SSIM_C1) * (2.0 * (xy - mx * my) + SSIM_C2)
                / ((mx * mx + my * my + SSIM_C1) * (xx - mx * mx + yy - my * my + SSIM_C2));
        }
    }
    sum / x.len() as f64
}

#[test]
fn ssim_is_the_direct_convolution() {
    for (width, height) in [(23, 17), (5, 30), (1, 1), (3, 2)] {
        let (x, y) = (plane(0, width * height), plane(1, width * height));
        let (got, _) = ssim(&x, &y, width, height);
        let want = direct_ssim(&x, &y, width, height);
        assert!((got - want).abs() < 1e-13, "{width} x {height}: {got} where {want} was expected");
    }
}

#[test]
fn equal_images_have_no_loss_and_no_gradient() {
    let x = plane(2, 12 * 9);
    let (loss, gradient) = photometric([&x; 3], [&x; 3], 12, 9, 0.2);
    assert!(loss.abs() < 1e-14);
    assert!(gradient.iter().flatten().all(|g| g.abs() < 1e-14));
}

#[test]
fn gradient_matches_central_differences() {
    for (width, height) in [(13, 8), (4, 3)] {
        for lambda in [0.0, 0.2, 1.0] {
            let n = width * height;
            let y = plane(3, 3 * n);
            let split = |p: &[f64]| [p[..n].to_vec(), p[n..2 * n].to_vec(), p[2 * n..].to_vec()];
            let loss = |p: &[f64]| {
                let (x, y) = (split(p), split(&y));
                photometric([&x[0], &x[1], &x[2]], [&y[0], &y[1], &y[2]], width, height, lambda)
            };
            let x = plane(4, 3 * n);
            let want = central_differences(&x, 1e-6, |x| loss(x).0);
            assert_gradient("photo", &loss(&x).1.concat(), &want.gradient, 1e-7);
        }
    }
}

#[test]
fn an_image_without_pixels_has_no_loss() {
    let none: [&[f64]; 3] = [&[]; 3];
    assert_eq!(photometric(none, none, 0, 0, 0.2).0, 0.0);
}
