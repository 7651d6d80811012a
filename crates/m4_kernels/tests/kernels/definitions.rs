//! The small references against closed forms: optimiser, tile lists, score, the steps of
//! compositing; the photometric loss against a direct two-dimensional convolution and central
//! differences.

use m4_core::{
    CounterRng,
    nalgebra::{Matrix2, Vector2},
};
use m4_kernels::{
    adam::{AdamParams, reference::step},
    blend::reference::{blend, blend_vjp, walk},
    ellipse::reference::{CHANNELS, Ellipse, Hard},
    loss::{
        SSIM_C1, SSIM_C2, WINDOW, WINDOW_SD,
        reference::{photometric, ssim},
    },
    score::reference::score,
    tile_binning::{
        TILE,
        reference::{depth_order, tiles},
    },
};
use m4_testkit::{assert_gradient, central_differences};

fn disc(x: f64, y: f64, sd: f64, opacity: f64) -> Ellipse<f64> {
    Ellipse {
        centre: Vector2::new(x, y),
        conic: Matrix2::from_diagonal_element(1.0 / (sd * sd)),
        opacity,
        channels: [0.25, 0.5, 0.75, 2.0, 1.0],
    }
}

#[test]
fn adam_moves_by_the_rate_under_a_constant_gradient() {
    // with bias correction both moments of a constant gradient are exact from the first step on
    let (mut x, mut m, mut v) = ([1.0f64; 3], [0.0; 3], [0.0; 3]);
    for count in 1..=20 {
        step(
            &mut x,
            &[3e-7, -4.0, 9.0],
            &mut m,
            &mut v,
            &[1, 1, 0],
            &[count; 3],
            0.01,
            &AdamParams::default(),
        );
    }
    assert!(
        (x[0] - 0.8).abs() < 1e-9 && (x[1] - 1.2).abs() < 1e-12,
        "{x:?}"
    );
    assert_eq!(
        (x[2], m[2], v[2]),
        (1.0, 0.0, 0.0),
        "a row that was not touched moved"
    );
}

#[test]
fn adam_follows_the_published_recursion() {
    let params = AdamParams {
        beta1: 0.5,
        beta2: 0.75,
        epsilon: 0.0,
    };
    let (mut x, mut m, mut v) = ([0.0], [0.0], [0.0]);
    step(&mut x, &[2.0], &mut m, &mut v, &[1], &[1], 1.0, &params);
    assert_eq!((x[0], m[0], v[0]), (-1.0, 1.0, 1.0));
    step(&mut x, &[0.0], &mut m, &mut v, &[1], &[2], 1.0, &params);
    // m = 0.5, v = 0.75; corrected by 0.75 and 0.4375
    let want: f64 = -1.0 - (0.5 / 0.75) / (0.75f64 / 0.4375).sqrt();
    assert!((x[0] - want).abs() < 1e-15 && m[0] == 0.5 && v[0] == 0.75);
}

#[test]
fn a_disc_reaches_the_tiles_within_its_radius() {
    // alpha = 1/255 at sd sqrt(2 ln(255 opacity)): 3 * 3.1155 = 9.35 pixels
    let splat = disc(20.0, 12.0, 3.0, 0.5);
    let radius = 3.0 * (2.0 * (255.0f64 * 0.5).ln()).sqrt();
    let (width, height) = (44, 30);
    let got = tiles(&splat, width, height);
    for row in 0..height.div_ceil(TILE) {
        for column in 0..width.div_ceil(TILE) {
            let near = |at: f64, tile: usize, size: usize| {
                let (low, high) = (tile * TILE, ((tile + 1) * TILE).min(size) - 1);
                at.clamp(low as f64, high as f64)
            };
            // centre and radius are such that the nearest pixel of each tile decides
            let d = Vector2::new(
                near(20.0, column, width) - 20.0,
                near(12.0, row, height) - 12.0,
            );
            assert_eq!(
                got.contains(&(column, row)),
                d.norm() <= radius,
                "tile {column}, {row}"
            );
        }
    }
    assert!(tiles(&disc(-30.0, 12.0, 3.0, 0.5), width, height).is_empty());
    assert!(
        tiles(&disc(20.0, 12.0, 3.0, 0.0039), width, height).is_empty(),
        "fainter than 1/255"
    );
}

#[test]
fn depth_order_is_stable() {
    assert_eq!(depth_order(&[2.0, 1.0, 2.0, 1.0]), [1, 3, 0, 2]);
}

#[test]
fn a_pixel_stops_before_its_transmittance_runs_out() {
    // 0.1, 0.01, 0.001; the fourth would leave 5e-5
    let splats = [
        disc(0.0, 0.0, 1.0, 0.9),
        disc(0.0, 0.0, 1.0, 0.9),
        disc(0.0, 0.0, 1.0, 0.9),
        disc(0.0, 0.0, 1.0, 0.95),
        // fits again, but the pixel is finished
        disc(0.0, 0.0, 1.0, 0.5),
    ];
    let mut indices = Vec::new();
    let left = walk::<f64, Hard>(&splats, 0, 0, |c| indices.push(c.index));
    assert_eq!(indices, [0, 1, 2]);
    assert!((left - 1e-3).abs() < 1e-15);
}

#[test]
fn alpha_is_cut_at_both_ends() {
    let image = blend::<f64, Hard>(&[disc(0.0, 0.0, 1.0, 1.0)], 5, 1, &[0.0; 3]);
    assert_eq!(image.pixels[0][4], 0.99);
    // e^-4.5 is 0.011; e^-8 is 0.0003, under 1/255
    assert!((image.pixels[3][4] - (-4.5f64).exp()).abs() < 1e-15);
    assert_eq!(image.pixels[4], [0.0; CHANNELS]);
    // cut at 0.99: no gradient to the opacity
    let mut g = vec![[0.0; CHANNELS]; 5];
    g[0] = [1.0; CHANNELS];
    let d = blend_vjp::<f64, Hard>(&[disc(0.0, 0.0, 1.0, 1.0)], 5, 1, &[0.0; 3], &g);
    assert!(d.splats[0].opacity == 0.0 && d.splats[0].channels[0] == 0.99);
}

#[test]
fn a_score_sums_the_pixels_that_a_splat_is_composited_on() {
    let (width, height) = (9, 9);
    let splats = [
        // 3 sd of half a pixel: the nearest 21 pixels, one after another by distance
        disc(4.0, 4.0, 0.5, 0.9),
        // opaque enough to be seen around the first, faint in time
        disc(4.0, 4.0, 2.0, 0.9),
    ];
    let weight: Vec<f64> = (0..width * height).map(|i| 1.0 + i as f64).collect();
    let within = |r: f64| {
        (0..width * height)
            .filter(|i| ((i % width) as f64 - 4.0).hypot((i / width) as f64 - 4.0) <= r)
            .map(|i| weight[i])
            .sum::<f64>()
    };
    let reach = |sd: f64| sd * (2.0 * (255.0f64 * 0.9).ln()).sqrt();
    let got = score(&splats, &[1.0, 0.25], width, &weight);
    assert!((got[0] - within(reach(0.5))).abs() < 1e-9, "{got:?}");
    assert!((got[1] - 0.25 * within(reach(2.0))).abs() < 1e-9, "{got:?}");
    // the middle of the sum is hidden once the stack in front is opaque
    let stack = [
        splats[1], splats[1], splats[1], splats[1], splats[1], splats[0],
    ];
    let got = score(&stack, &[1.0; 6], width, &weight);
    assert!(got[5] < within(reach(0.5)) && got[5] >= 0.0, "{got:?}");
}

fn plane(index: u64, n: usize) -> Vec<f64> {
    let mut rng = CounterRng::new(5, 1, index);
    (0..n).map(|_| rng.uniform()).collect()
}

/// SSIM as Wang et al. write it: a sum over the whole two-dimensional window at each pixel, zeros
/// outside the image.
fn direct_ssim(x: &[f64], y: &[f64], width: usize, height: usize) -> f64 {
    let half = (WINDOW / 2) as isize;
    let raw =
        |i: isize, j: isize| (-((i * i + j * j) as f64) / (2.0 * WINDOW_SD * WINDOW_SD)).exp();
    let norm: f64 = (-half..=half)
        .flat_map(|i| (-half..=half).map(move |j| raw(i, j)))
        .sum();
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
        assert!(
            (got - want).abs() < 1e-13,
            "{width} x {height}: {got} where {want} was expected"
        );
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
                photometric(
                    [&x[0], &x[1], &x[2]],
                    [&y[0], &y[1], &y[2]],
                    width,
                    height,
                    lambda,
                )
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
