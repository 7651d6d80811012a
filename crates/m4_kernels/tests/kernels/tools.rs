//! The CPU twins of loss, adam and bin against their references.

use crate::twin::{every_level, view};
use m4_core::{Camera, CounterRng, SplatLayout, Splats};
use m4_kernels::{
    Gradients, Renderer,
    adam::{
        AdamParams, FIXED,
        cpu::{AdamConfig, AdamState, step},
        reference,
    },
    loss::{
        cpu::{LossScratch, Target, error_map, loss},
        reference::photometric,
    },
    tile_binning::reference::tiles,
};
use m4_testkit::{SceneSpec, assert_gradient, random_camera, random_splats};

fn image(index: u64, n: usize) -> [Vec<f32>; 3] {
    std::array::from_fn(|c| {
        let mut rng = CounterRng::new(31, index, c as u64);
        // waves with noise: windows with much and with little contrast
        (0..n)
            .map(|i| (0.5 + 0.4 * (1.0 + i as f64 * 0.05).sin() * rng.uniform()) as f32)
            .collect()
    })
}

fn exact(planes: &[Vec<f32>; 3]) -> [Vec<f64>; 3] {
    planes
        .each_ref()
        .map(|p| p.iter().map(|&v| f64::from(v)).collect())
}

/// A photograph and its colours.
fn photograph(index: u64, width: usize, height: usize) -> (Target, [Vec<f32>; 3]) {
    let bytes =
        image(index, width * height).map(|p| p.iter().map(|v| (v * 255.0).round() as u8).collect());
    let target = Target::from_bytes(width, height, bytes).expect("planes of that size");
    let rgb = target.rgb();
    (target, rgb)
}

#[test]
fn a_target_takes_over_the_memory_of_another() {
    let (target, rgb) = photograph(90, 37, 22);
    for (plane, bytes) in rgb.iter().zip(target.planes()) {
        assert!(
            plane
                .iter()
                .zip(bytes)
                .all(|(v, &b)| (v - f32::from(b) / 255.0).abs() < 1e-6)
        );
    }
    let (mut again, _) = photograph(91, 40, 30);
    again.replace(37, 22, |planes| {
        planes
            .into_iter()
            .zip(target.planes())
            .for_each(|(to, from)| to.copy_from_slice(from));
    });
    assert_eq!(again, target);
    assert!(Target::from_bytes(3, 3, Default::default()).is_err());
}

#[test]
fn loss_of_every_size() {
    let sizes = [
        (1, 1),
        (3, 2),
        (5, 40),
        (40, 5),
        (11, 11),
        (16, 16),
        (17, 33),
        (64, 48),
        (101, 23),
    ];
    every_level(|level| {
        let (mut scratch, mut got) = (LossScratch::default(), Default::default());
        for (index, (width, height)) in sizes.into_iter().enumerate() {
            for lambda in [0.0, 0.2, 1.0] {
                let n = width * height;
                let (x, (target, y)) = (
                    image(2 * index as u64, n),
                    photograph(2 * index as u64 + 1, width, height),
                );
                let parts = loss(level, &target, &x, lambda, &mut scratch, &mut got);
                let (a, b) = (exact(&x), exact(&y));
                let (want, gradient) = photometric(
                    [&a[0], &a[1], &a[2]],
                    [&b[0], &b[1], &b[2]],
                    width,
                    height,
                    f64::from(lambda),
                );
                let name = format!("{width} x {height}, lambda {lambda} on {level}");
                // SSIM near 1 is known to the last bits of 1
                let allowed = 2e-6 * want + 2e-7;
                assert!(
                    (parts.total - want).abs() < allowed,
                    "{name}: {parts:?}, {want}"
                );
                let lambda = f64::from(lambda);
                let sum = (1.0 - lambda) * parts.l1 + lambda * (1.0 - parts.ssim);
                assert!(
                    (parts.total - sum).abs() < 1e-6,
                    "{name}: {parts:?} does not add up"
                );
                let flat: Vec<f64> = exact(&got).concat();
                assert_gradient(&name, &flat, &gradient.concat(), 1e-4);
            }
        }
    });
}

#[test]
fn loss_of_equal_and_of_flat_images() {
    every_level(|level| {
        let (width, height) = (37, 21);
        let flat = std::array::from_fn(|c| vec![64 * c as u8; width * height]);
        for target in [
            photograph(9, width, height).0,
            Target::from_bytes(width, height, flat).unwrap(),
        ] {
            let x = target.rgb();
            let mut gradient = Default::default();
            let parts = loss(
                level,
                &target,
                &x,
                0.2,
                &mut LossScratch::default(),
                &mut gradient,
            );
            assert!(
                parts.total.abs() < 1e-6 && parts.l1 == 0.0,
                "{level}: {parts:?}"
            );
            // per pixel and channel a wrong sign of L1 alone would be 0.8 / count = 3e-4
            let largest = gradient
                .iter()
                .flatten()
                .fold(0.0f32, |m, g| m.max(g.abs()));
            assert!(largest < 1e-5, "{level}: {largest}");
        }
    });
}

#[test]
fn error_map_is_the_mean_absolute_difference() {
    every_level(|level| {
        let (width, height) = (19, 7);
        let (x, (target, y)) = (image(1, width * height), photograph(2, width, height));
        let mut got = Vec::new();
        error_map(level, &target, &x, &mut got);
        assert_eq!(got.len(), width * height);
        for (i, got) in got.into_iter().enumerate() {
            let want = (0..3).map(|c| (x[c][i] - y[c][i]).abs()).sum::<f32>() / 3.0;
            assert!((got - want).abs() < 1e-6, "pixel {i} on {level}");
        }
    });
}

fn small_scene(seed: u64) -> (Camera, Splats) {
    let camera = random_camera(seed, 30, 20);
    let spec = SceneSpec {
        layout: SplatLayout {
            isotropic: false,
            sh_degree: 1,
            time_degree: 1,
        },
        n_static: 37,
        n_dynamic: 21,
        ..SceneSpec::default()
    };
    (camera, random_splats(seed, &camera, &spec))
}

#[test]
fn adam_sparse_dense_and_fixed() {
    every_level(|level| {
        for sparse in [true, false] {
            let (_, mut splats) = small_scene(3);
            let config = AdamConfig {
                sparse,
                ..AdamConfig::default()
            };
            let mut state = AdamState::new(&splats);
            let rates: Vec<f32> = (0..splats.columns().len())
                .map(|c| 1e-3 * (1.0 + c as f32))
                .collect();
            let mut x: Vec<Vec<f64>> = splats
                .columns()
                .iter()
                .map(|c| c.iter().map(|&v| f64::from(v)).collect())
                .collect();
            let (mut m, mut v): (Vec<Vec<f64>>, Vec<Vec<f64>>) = x
                .iter()
                .map(|c| (vec![0.0; c.len()], vec![0.0; c.len()]))
                .unzip();
            // static and dynamic ones, next to others of the same lanes
            let mut count: Vec<u32> = (0..splats.n())
                .map(|row| if row % 7 == 3 { FIXED } else { 0 })
                .collect();
            state.step.copy_from_slice(&count);
            let (n_static, shared) = (splats.n_static(), splats.layout().shared_columns());

            for iteration in 0..25 {
                let mut rng = CounterRng::new(41, iteration, 0);
                let mut gradients = Gradients::default();
                gradients.reset(&splats);
                gradients
                    .touched
                    .iter_mut()
                    .for_each(|t| *t = u8::from(rng.uniform() < 0.6));
                for column in &mut gradients.columns {
                    // from 1e-9 to 1: epsilon must not be felt; rows that are not touched hold
                    // rubbish
                    let size = 10f64.powf(-9.0 * rng.uniform());
                    column
                        .iter_mut()
                        .for_each(|g| *g = (size * rng.normal()) as f32);
                }
                for (count, &t) in count.iter_mut().zip(&gradients.touched) {
                    *count += u32::from(*count != FIXED && (t != 0 || !sparse));
                }
                for c in 0..x.len() {
                    let first = if c < shared { 0 } else { n_static };
                    for k in 0..x[c].len() {
                        let row = first + k;
                        let touched = gradients.touched[row] != 0;
                        let params = AdamParams {
                            beta1: config.beta1,
                            beta2: if row < n_static {
                                config.beta2
                            } else {
                                config.beta2_dynamic
                            },
                            epsilon: config.eps,
                        };
                        let g = if touched {
                            f64::from(gradients.columns[c][k])
                        } else {
                            0.0
                        };
                        reference::step(
                            &mut x[c][k..=k],
                            &[g],
                            &mut m[c][k..=k],
                            &mut v[c][k..=k],
                            &[u8::from(touched || !sparse)],
                            &[count[row]],
                            f64::from(rates[c]),
                            &params,
                        );
                    }
                }
                step(level, &mut splats, &gradients, &mut state, &config, &rates);
            }
            assert_eq!(state.step, count);
            for (c, want) in x.iter().enumerate() {
                for (k, want) in want.iter().enumerate() {
                    let got = f64::from(splats.columns()[c][k]);
                    let allowed = 2e-5 * f64::from(rates[c]) * 25.0 + 3e-6 * want.abs().max(0.1);
                    assert!(
                        (got - want).abs() < allowed,
                        "{level}, sparse {sparse}: column {c}, row {k}: {got} where {want} was expected"
                    );
                }
            }
        }
    });
}

#[test]
fn adam_does_not_move_on_a_gradient_of_0() {
    every_level(|level| {
        let (_, mut splats) = small_scene(4);
        let before = splats.clone();
        let mut gradients = Gradients::default();
        gradients.reset(&splats);
        gradients.touched.fill(1);
        let mut state = AdamState::new(&splats);
        let rates = vec![0.1; splats.columns().len()];
        step(
            level,
            &mut splats,
            &gradients,
            &mut state,
            &AdamConfig::default(),
            &rates,
        );
        assert_eq!(splats, before);
    });
}

/// One splat at a time: the lists of the twin hold every tile that it reaches, and few others.
#[test]
fn tile_lists_hold_every_tile_that_a_splat_reaches() {
    every_level(|level| {
        let (mut listed, mut needed) = (0, 0);
        let mut renderer = Renderer::new(level);
        for seed in 0..1500 {
            let camera = random_camera(seed, 61, 43);
            let spec = SceneSpec {
                n_static: 1,
                n_dynamic: 0,
                sd_px: [0.3, 14.0],
                logit: [-5.0, 6.0],
                ..SceneSpec::default()
            };
            let splats = random_splats(seed, &camera, &spec);
            let expected = crate::twin::Expected::new(&splats, &view(camera));
            renderer.render(&splats, &view(camera));
            let got = renderer.stats().pairs;
            let Some(&ellipse) = expected.rendered.ellipses.first() else {
                assert!(
                    got <= 1,
                    "{level}, splat {seed}: fainter than the cut-off, listed {got} times"
                );
                continue;
            };
            // a hair above the cut-off, where f32 cannot disagree
            let mut sure = ellipse;
            sure.opacity *= 1.0 - 1e-4;
            let sure = tiles(&sure, 61, 43).len();
            assert!(
                got >= sure,
                "{level}, splat {seed}: {got} tiles listed, {sure} reached"
            );
            listed += got;
            needed += sure;
        }
        // a list may hold tiles that the ellipse enters between two pixels
        assert!(
            needed > 10_000 && listed as f64 <= 1.03 * needed as f64,
            "{level}: {listed} for {needed}"
        );
    });
}
