//! The small references against closed forms: optimiser, tile lists, score, and the steps of
//! compositing.

use m4_core::nalgebra::{Matrix2, Vector2};
use m4_kernels::{
    adam::{AdamParams, reference::step},
    blend::reference::{CHANNELS, Ellipse, Hard, blend, blend_vjp, walk},
    score::reference::score,
    tile_binning::{
        TILE,
        reference::{depth_order, tiles},
    },
};

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
        step(&mut x, &[3e-7, -4.0, 9.0], &mut m, &mut v, &[1, 1, 0], &[count; 3], 0.01, &AdamParams::default());
    }
    assert!((x[0] - 0.8).abs() < 1e-9 && (x[1] - 1.2).abs() < 1e-12, "{x:?}");
    assert_eq!((x[2], m[2], v[2]), (1.0, 0.0, 0.0), "a row that was not touched moved");
}

#[test]
fn adam_follows_the_published_recursion() {
    let params = AdamParams { beta1: 0.5, beta2: 0.75, epsilon: 0.0 };
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
            let d = Vector2::new(near(20.0, column, width) - 20.0, near(12.0, row, height) - 12.0);
            assert_eq!(got.contains(&(column, row)), d.norm() <= radius, "tile {column}, {row}");
        }
    }
    assert!(tiles(&disc(-30.0, 12.0, 3.0, 0.5), width, height).is_empty());
    assert!(tiles(&disc(20.0, 12.0, 3.0, 0.0039), width, height).is_empty(), "fainter than 1/255");
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
    let mut seen = Vec::new();
    let left = walk::<f64, Hard>(&splats, 0, 0, |c| seen.push(c.index));
    assert_eq!(seen, [0, 1, 2]);
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
    let stack = [splats[1], splats[1], splats[1], splats[1], splats[1], splats[0]];
    let got = score(&stack, &[1.0; 6], width, &weight);
    assert!(got[5] < within(reach(0.5)) && got[5] >= 0.0, "{got:?}");
}
