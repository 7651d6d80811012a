//! Every backward pass of the reference against central differences, in f64.
//!
//! The loss is a sum with random weights: a plain mean hides mistakes that cancel. Compositing runs
//! with the smooth cut-off, since the hard one makes the image jump.

use m4_core::{
    CounterRng, Se3,
    nalgebra::{Matrix2, Matrix3, Vector2, Vector3, Vector4, Vector6},
};
use m4_kernels::{
    blend::reference::{blend, blend_vjp},
    ellipse::reference::{CHANNELS, Ellipse, Smooth},
    project::reference::{Pinhole, Projected, project, project_vjp},
    reference::{expose, expose_vjp},
    shade::reference::{Sight, shade, shade_vjp},
    slice::reference::{
        Gaussian, Life, RotorGaussian, Shape, Sliced, slice, slice_rotor, slice_rotor_vjp,
        slice_vjp,
    },
};
use m4_testkit::{assert_gradient, central_differences};

const STEP: f64 = 1e-6;
const TOLERANCE: f64 = 1e-7;

/// Numbers between -1 and 1.
fn noise(purpose: u64, index: u64, n: usize) -> Vec<f64> {
    let mut rng = CounterRng::new(17, purpose, index);
    (0..n).map(|_| 2.0 * rng.uniform() - 1.0).collect()
}

fn symmetric(v: &[f64]) -> Matrix3<f64> {
    Matrix3::new(v[0], v[1], v[2], v[1], v[3], v[4], v[2], v[4], v[5])
}

/// The gradient with respect to the six numbers of [`symmetric`].
fn symmetric_vjp(g: &Matrix3<f64>) -> [f64; 6] {
    let at = |i, j| g[(i, j)] + g[(j, i)];
    [
        g[(0, 0)],
        at(0, 1),
        at(0, 2),
        g[(1, 1)],
        at(1, 2),
        g[(2, 2)],
    ]
}

fn check(what: &str, got: &[f64], x: &[f64], f: impl FnMut(&[f64]) -> f64) {
    let want = central_differences(x, STEP, f);
    assert_gradient(what, got, &want.gradient, TOLERANCE);
}

fn sliced_weights(index: u64) -> Sliced<f64> {
    let w = noise(1, index, 10);
    Sliced {
        mean: Vector3::new(w[0], w[1], w[2]),
        covariance: symmetric(&w[3..9]),
        marginal: w[9],
    }
}

fn weigh(s: &Sliced<f64>, w: &Sliced<f64>) -> f64 {
    s.mean.dot(&w.mean) + s.covariance.dot(&w.covariance) + s.marginal * w.marginal
}

fn gaussian(v: &[f64], isotropic: bool, dynamic: bool) -> Gaussian<f64> {
    let shape = if isotropic {
        Shape::Isotropic { log_scale: v[3] }
    } else {
        Shape::Anisotropic {
            log_scale: Vector3::new(v[3], v[4], v[5]),
            quat: Vector4::new(v[6], v[7], v[8], v[9]),
        }
    };
    let at = if isotropic { 4 } else { 10 };
    Gaussian {
        mean: Vector3::new(v[0], v[1], v[2]),
        shape,
        life: dynamic.then(|| Life {
            time_mean: v[at],
            log_time_sd: v[at + 1],
            velocity: Vector3::new(v[at + 2], v[at + 3], v[at + 4]),
        }),
    }
}

fn gaussian_values(g: &Gaussian<f64>) -> Vec<f64> {
    let mut v: Vec<f64> = g.mean.iter().copied().collect();
    match &g.shape {
        Shape::Isotropic { log_scale } => v.push(*log_scale),
        Shape::Anisotropic { log_scale, quat } => v.extend(log_scale.iter().chain(quat.iter())),
    }
    if let Some(life) = &g.life {
        v.extend([life.time_mean, life.log_time_sd]);
        v.extend(life.velocity.iter());
    }
    v
}

#[test]
fn slice_velocity_form() {
    for index in 0..8 {
        for (isotropic, dynamic) in [(false, false), (false, true), (true, false), (true, true)] {
            let n = 3 + if isotropic { 1 } else { 7 } + if dynamic { 5 } else { 0 };
            let (x, w, t) = (noise(2, index, n), sliced_weights(index), 0.7);
            let got = slice_vjp(&gaussian(&x, isotropic, dynamic), t, &w);
            check("slice", &gaussian_values(&got), &x, |x| {
                weigh(&slice(&gaussian(x, isotropic, dynamic), t), &w)
            });
        }
    }
}

#[test]
fn slice_rotor_form() {
    let rotor = |v: &[f64]| RotorGaussian {
        mean: Vector3::new(v[0], v[1], v[2]),
        time_mean: v[3],
        log_scale: Vector4::new(v[4], v[5], v[6], v[7]),
        left: Vector4::new(v[8], v[9], v[10], v[11]),
        right: Vector4::new(v[12], v[13], v[14], v[15]),
    };
    for index in 0..8 {
        let (x, w, t) = (noise(3, index, 16), sliced_weights(index), 0.7);
        let got = slice_rotor_vjp(&rotor(&x), t, &w);
        let mut flat: Vec<f64> = got.mean.iter().copied().collect();
        flat.push(got.time_mean);
        flat.extend(
            got.log_scale
                .iter()
                .chain(got.left.iter())
                .chain(got.right.iter()),
        );
        check("slice_rotor", &flat, &x, |x| {
            weigh(&slice_rotor(&rotor(x), t), &w)
        });
    }
}

#[test]
fn project_all_inputs() {
    let camera = |twist: &[f64], intrinsics: &[f64]| {
        let base = Se3::identity().retract(&Vector6::new(0.1, -0.2, 0.3, 0.2, -0.1, 0.15));
        Pinhole {
            w2c: base.retract(&Vector6::from_column_slice(twist)),
            intrinsics: Vector4::from_column_slice(intrinsics),
            limits: [-0.6, 0.5, -0.45, 0.55],
        }
    };
    // inside, and past the clamp on each side
    let means = [
        [0.2, -0.3, 2.0],
        [1.9, 0.1, 2.2],
        [-1.8, 0.2, 1.5],
        [0.1, 1.7, 1.8],
        [1.6, -1.9, 1.6],
    ];
    for (index, mean) in means.iter().enumerate() {
        for mip in [false, true] {
            let b = symmetric(&noise(4, index as u64, 6));
            let s = b * b.transpose() * 0.02 + Matrix3::from_diagonal_element(0.003);
            let mut x = mean.to_vec();
            x.extend([
                s[(0, 0)],
                s[(0, 1)],
                s[(0, 2)],
                s[(1, 1)],
                s[(1, 2)],
                s[(2, 2)],
            ]);
            x.extend([0.0; 6]);
            x.extend([30.0, 33.0, 12.0, 9.0]);
            let w = noise(5, index as u64, 7);
            let weights = Projected {
                centre: Vector2::new(w[0], w[1]),
                // the conic is small where the others are large: weigh it up
                conic: Matrix2::new(w[2], w[3], w[3], w[4]) * 50.0,
                depth: w[5],
                compensation: if mip { 10.0 * w[6] } else { 0.0 },
            };
            let parts = |x: &[f64]| {
                let mean = Vector3::new(x[0], x[1], x[2]);
                (mean, symmetric(&x[3..9]), camera(&x[9..15], &x[15..19]))
            };
            let loss = |x: &[f64]| {
                let (mean, covariance, camera) = parts(x);
                let p = project(&mean, &covariance, &camera, 0.2, mip).unwrap();
                p.centre.dot(&weights.centre)
                    + p.conic.dot(&weights.conic)
                    + p.depth * weights.depth
                    + p.compensation * weights.compensation
            };
            let (m, c, k) = parts(&x);
            let g = project_vjp(&m, &c, &k, mip, &weights);
            let name = format!("project, splat {index}, mip {mip}");
            // every kind of parameter on its own scale
            let groups: [(&str, std::ops::Range<usize>, Vec<f64>); 5] = [
                ("mean", 0..3, g.mean.as_slice().to_vec()),
                ("covariance", 3..9, symmetric_vjp(&g.covariance).to_vec()),
                ("tau", 9..12, g.camera.tau.as_slice().to_vec()),
                ("omega", 12..15, g.camera.omega.as_slice().to_vec()),
                (
                    "intrinsics",
                    15..19,
                    g.camera.intrinsics.as_slice().to_vec(),
                ),
            ];
            for (kind, range, got) in groups {
                check(
                    &format!("{name}: {kind}"),
                    &got,
                    &x[range.clone()],
                    |part| {
                        let mut x = x.clone();
                        x[range.clone()].copy_from_slice(part);
                        loss(&x)
                    },
                );
            }
        }
    }
}

#[test]
fn project_leaves_out_what_is_not_in_front() {
    let camera = Pinhole {
        w2c: Se3::<f64>::identity(),
        intrinsics: Vector4::new(10.0, 10.0, 5.0, 5.0),
        limits: [-1.0, 1.0, -1.0, 1.0],
    };
    let covariance = Matrix3::identity();
    for z in [0.2, 0.0, -1.0, f64::NAN] {
        assert!(project(&Vector3::new(0.0, 0.0, z), &covariance, &camera, 0.2, false).is_none());
    }
    assert!(
        project(
            &Vector3::new(0.0, 0.0, 0.2001),
            &covariance,
            &camera,
            0.2,
            false
        )
        .is_some()
    );
}

#[test]
fn a_splat_seen_edge_on_has_a_finite_gradient_with_the_mip_filter() {
    let camera = Pinhole {
        w2c: Se3::<f64>::identity(),
        intrinsics: Vector4::new(10.0, 10.0, 5.0, 5.0),
        limits: [-1.0, 1.0, -1.0, 1.0],
    };
    let mean = Vector3::new(0.0, 0.0, 2.0);
    let flat = Matrix3::from_diagonal(&Vector3::new(0.1, 0.0, 0.0));
    let p = project(&mean, &flat, &camera, 0.2, true).unwrap();
    assert_eq!(p.compensation, 0.0);
    let g = project_vjp(&mean, &flat, &camera, true, &p);
    assert!(
        g.mean
            .iter()
            .chain(g.covariance.iter())
            .all(|v| v.is_finite())
    );
}

#[test]
fn shade_every_degree() {
    for index in 0..4 {
        for (degree, times) in [(0, 1), (1, 1), (2, 2), (3, 3), (0, 3)] {
            let sh_terms = (degree + 1) * (degree + 1);
            let n = 3 * sh_terms * times;
            let mut x = noise(6, index, n + 4);
            // one channel in the dark now and then
            x[0] -= if index == 1 { 4.0 } else { 0.0 };
            let w = noise(7, index, 3);
            let weights = [w[0], w[1], w[2]];
            let parts = |x: &[f64]| {
                let coefficients: Vec<[f64; 3]> =
                    x[..n].chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
                let sight = Sight {
                    offset: Vector3::new(x[n], x[n + 1], x[n + 2] + 2.0),
                    dt: 0.4 - x[n + 3],
                    period: 1.7,
                    sh_terms,
                };
                (coefficients, sight)
            };
            let (coefficients, sight) = parts(&x);
            let g = shade_vjp(&coefficients, &sight, &weights);
            let mut got: Vec<f64> = g.coefficients.iter().flatten().copied().collect();
            got.extend(g.offset.iter());
            got.push(g.time_mean);
            check("shade", &got, &x, |x| {
                let (coefficients, sight) = parts(x);
                let c = shade(&coefficients, &sight);
                c.iter().zip(&weights).map(|(c, w)| c * w).sum()
            });
        }
    }
}

#[test]
fn a_dark_channel_has_no_gradient() {
    let sight = Sight {
        offset: Vector3::z(),
        dt: 0.0,
        period: 1.0,
        sh_terms: 1,
    };
    let coefficients = [[-3.0, 0.0, 1.0]];
    assert_eq!(shade(&coefficients, &sight)[0], 0.0);
    let g = shade_vjp(&coefficients, &sight, &[1.0; 3]);
    assert!(g.coefficients[0][0] == 0.0 && g.coefficients[0][1] > 0.0);
}

const PER_SPLAT: usize = 6 + CHANNELS;

fn ellipses(x: &[f64]) -> Vec<Ellipse<f64>> {
    x.chunks_exact(PER_SPLAT)
        .map(|v| Ellipse {
            centre: Vector2::new(v[0], v[1]),
            conic: Matrix2::new(v[2], v[3], v[3], v[4]),
            opacity: v[5],
            channels: std::array::from_fn(|c| v[6 + c]),
        })
        .collect()
}

#[test]
fn blend_all_inputs() {
    let (width, height, n) = (13, 9, 8);
    for index in 0..4 {
        let mut rng = CounterRng::new(17, 8, index);
        let mut x = Vec::new();
        for _ in 0..n {
            let mut between = |low: f64, high: f64| low + (high - low) * rng.uniform();
            x.extend([between(0.0, 13.0), between(0.0, 9.0)]);
            let (a, b) = (between(0.03, 0.4), between(0.03, 0.4));
            x.extend([a, between(-0.8, 0.8) * (a * b).sqrt(), b]);
            x.push(between(0.1, 0.999));
            x.extend((0..CHANNELS).map(|_| rng.uniform()));
        }
        x.extend([0.1, 0.5, 0.9]);
        let split = n * PER_SPLAT;
        let background = |x: &[f64]| [x[split], x[split + 1], x[split + 2]];
        let w = noise(9, index, width * height * CHANNELS);
        let weights: Vec<[f64; CHANNELS]> = w
            .chunks(CHANNELS)
            .map(|c| std::array::from_fn(|k| c[k]))
            .collect();
        let splats = ellipses(&x[..split]);
        let image = blend::<f64, Smooth>(&splats, width, height, &background(&x));
        for (pixel, t) in image.pixels.iter().zip(&image.transmittance) {
            assert!((0.0..=1.0).contains(t) && pixel.iter().all(|v| v.is_finite()));
        }
        let g = blend_vjp::<f64, Smooth>(&splats, width, height, &background(&x), &weights);
        let mut got = Vec::new();
        for s in &g.splats {
            got.extend(s.centre.iter());
            got.extend([
                s.conic[(0, 0)],
                s.conic[(0, 1)] + s.conic[(1, 0)],
                s.conic[(1, 1)],
                s.opacity,
            ]);
            got.extend(s.channels);
        }
        got.extend(g.background);
        check("blend", &got, &x, |x| {
            let image = blend::<f64, Smooth>(&ellipses(&x[..split]), width, height, &background(x));
            image
                .pixels
                .iter()
                .flatten()
                .zip(&w)
                .map(|(v, w)| v * w)
                .sum()
        });
    }
}

#[test]
fn expose_pixels_and_matrix() {
    let n = 5;
    let x = noise(10, 0, n * CHANNELS + 12);
    let w = noise(11, 0, 3 * n);
    let weights: Vec<[f64; 3]> = w.chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
    let parts = |x: &[f64]| {
        let pixels: Vec<[f64; CHANNELS]> = x[..n * CHANNELS]
            .chunks(CHANNELS)
            .map(|c| std::array::from_fn(|k| c[k]))
            .collect();
        let m = &x[n * CHANNELS..];
        let exposure: [[f64; 4]; 3] =
            std::array::from_fn(|i| std::array::from_fn(|j| m[4 * i + j]));
        (pixels, exposure)
    };
    let (pixels, exposure) = parts(&x);
    let (d_pixels, d_exposure) = expose_vjp(&pixels, &exposure, &weights);
    let mut got: Vec<f64> = d_pixels
        .iter()
        .flat_map(|p| [p[0], p[1], p[2], 0.0, 0.0])
        .collect();
    got.extend(d_exposure.as_flattened());
    check("expose", &got, &x, |x| {
        let (pixels, exposure) = parts(x);
        expose(&pixels, &exposure)
            .iter()
            .flatten()
            .zip(&w)
            .map(|(v, w)| v * w)
            .sum()
    });
}
