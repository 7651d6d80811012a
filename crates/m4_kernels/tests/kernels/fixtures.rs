//! The reference against the float64 oracle: `fixtures/gradients`, made by
//! `oracles/check_4dgs_grads.py`, in the types of the reference.

use m4_core::{
    Real, Se3,
    nalgebra::{Matrix3, Matrix4, Rotation3, UnitQuaternion, Vector3, Vector4},
    rotor,
};
use m4_kernels::{
    ellipse::{
        self,
        reference::{CHANNELS, Cutoff, Hard},
    },
    loss::reference::photometric,
    project::{self, reference::Pinhole},
    reference::{Geometry, SceneGradient, Setup, Splat, backward, expose, expose_vjp, render},
    slice::reference::{Gaussian, Life, RotorGaussian, Shape},
};
use m4_testkit::{
    FixtureSplat, GradientCase, GradientFixtures, assert_gradient, gradient_fixtures,
};

#[test]
fn constants_are_those_of_the_oracle() {
    let fixtures = gradient_fixtures();
    assert_eq!(fixtures.low_pass, project::LOW_PASS);
    assert_eq!(fixtures.jacobian_clamp, project::JACOBIAN_CLAMP);
    assert_eq!(fixtures.alpha_max, ellipse::ALPHA_MAX);
    assert_eq!(fixtures.alpha_min, ellipse::ALPHA_MIN);
    assert_eq!(fixtures.t_min, ellipse::T_MIN);
    for case in &fixtures.cases {
        let limits = project::jacobian_limits(&camera(case).intrinsics);
        let [x, y] = case.camera.tan.map(|tan| fixtures.jacobian_clamp * tan);
        for (got, want) in limits.into_iter().zip([-x, x, -y, y]) {
            assert!(
                (got - want).abs() < 1e-14,
                "{got} where {want} was expected"
            );
        }
    }
}

fn check<T: Real>(case: &GradientCase, run: &Run<T>, tolerance: f64) {
    let name = case.name();
    let want: Vec<_> = case.grad_splats.iter().map(splat::<f64>).collect();
    for ((kind, got), (want_kind, want)) in by_name(&run.gradient.splats)
        .into_iter()
        .zip(by_name(&want))
    {
        assert_eq!((kind, got.len()), (want_kind, want.len()));
        if kind == "velocity" && case.model == "isotropic" {
            // the oracle's isotropic model is static: nothing to compare with
            continue;
        }
        assert_gradient(&format!("{name}: {kind}"), &got, &want, tolerance);
    }
    let check = |what: &str, got: &[T], want: &[f64]| {
        let got: Vec<f64> = got.iter().map(|v| v.f64()).collect();
        assert_gradient(&format!("{name}: {what}"), &got, want, tolerance);
    };
    check(
        "tau",
        run.gradient.camera.tau.as_slice(),
        &case.grad_translation,
    );
    check(
        "omega",
        run.gradient.camera.omega.as_slice(),
        &case.grad_rotation,
    );
    check(
        "intrinsics",
        run.gradient.camera.intrinsics.as_slice(),
        &case.grad_intrinsics,
    );
    check(
        "exposure",
        run.loss.exposure.as_flattened(),
        case.grad_exposure.as_flattened(),
    );
    check(
        "background",
        &run.gradient.background,
        &case.grad_background,
    );
    let means: Vec<T> = run
        .gradient
        .means2d
        .iter()
        .flat_map(|m| [m.x, m.y])
        .collect();
    check("means2d", &means, case.grad_means2d.as_flattened());
}

/// Loss and gradients of every fixture, to these relative errors.
fn check_all<T: Real>(loss_tolerance: f64, tolerance: f64) {
    let fixtures = gradient_fixtures();
    for case in &fixtures.cases {
        let run = run::<T, Hard>(&fixtures, case);
        let off = (run.loss.value.f64() / case.loss - 1.0).abs();
        assert!(off < loss_tolerance, "{}: loss off by {off:e}", case.name());
        check(case, &run, tolerance);
        assert!(
            run.gradient.touched.iter().filter(|&&t| t).count() >= 5,
            "{}",
            case.name()
        );
    }
}

#[test]
fn the_reference_equals_the_oracle_to_rounding() {
    check_all::<f64>(1e-10, 1e-7);
    check_all::<f32>(1e-5, 2e-3);
}

/// docs/spec/optimiser.md 1.4: the velocity form is an exact reparametrisation of the rotor form.
#[test]
fn rotor_and_velocity_form_render_the_same_image() {
    let fixtures = gradient_fixtures();
    for case in fixtures.cases.iter().filter(|c| c.model == "rotor") {
        let rotor: Vec<_> = case.splats.iter().map(splat::<f64>).collect();
        let velocity: Vec<_> = case
            .splats
            .iter()
            .map(|s| splat::<f64>(&converted(s)))
            .collect();
        for t in [0.0, 0.2, 0.55, 0.8, 1.1] {
            let setup = Setup {
                t,
                ..setup::<f64>(case)
            };
            let [a, b] = [&rotor, &velocity].map(|splats| render::<f64, Hard>(splats, &setup));
            assert_eq!(a.rows, b.rows, "{} at {t}", case.name());
            assert!(a.rows.len() > 3, "{} at {t}", case.name());
            for (x, y) in a
                .image
                .pixels
                .as_flattened()
                .iter()
                .zip(b.image.pixels.as_flattened())
            {
                assert!((x - y).abs() < 1e-12, "{} at {t}: {x} and {y}", case.name());
            }
        }
    }
}

/// Spatial harmonics in the fixtures: degree 3.
pub const SH_TERMS: usize = 16;

/// One plane per channel.
pub fn planes<T: Real>(pixels: &[[T; 3]]) -> [Vec<T>; 3] {
    std::array::from_fn(|c| pixels.iter().map(|p| p[c]).collect())
}

/// The loss of the fixtures with its gradients with respect to pixels and exposure.
pub struct Loss<T: Real> {
    pub value: T,
    pub pixels: Vec<[T; CHANNELS]>,
    pub exposure: [[T; 4]; 3],
}

/// What the fixtures compare with.
pub struct Target<T: Real> {
    pub rgb: [Vec<T>; 3],
    pub depth: Vec<T>,
    pub lambda: T,
    pub depth_weight: T,
}

impl<T: Real> Target<T> {
    pub fn new(fixtures: &GradientFixtures, case: &GradientCase) -> Self {
        let rgb: Vec<[T; 3]> = case.gt.iter().flatten().map(|p| p.map(T::of)).collect();
        Self {
            rgb: planes(&rgb),
            depth: case.gt_depth.iter().flatten().map(|&z| T::of(z)).collect(),
            lambda: T::of(fixtures.lambda_ssim),
            depth_weight: T::of(fixtures.depth_weight),
        }
    }

    /// `photometric(exposed colours) + weight mean (sum of w (z - z_gt))^2`.
    pub fn loss(&self, pixels: &[[T; CHANNELS]], width: usize, exposure: &[[T; 4]; 3]) -> Loss<T> {
        let height = pixels.len() / width;
        let rgb = planes(&expose(pixels, exposure));
        let (mut value, d_rgb) = photometric(
            [&rgb[0], &rgb[1], &rgb[2]],
            [&self.rgb[0], &self.rgb[1], &self.rgb[2]],
            width,
            height,
            self.lambda,
        );
        let d_exposed: Vec<[T; 3]> = (0..pixels.len())
            .map(|i| std::array::from_fn(|c| d_rgb[c][i]))
            .collect();
        let (d_colour, d_exposure) = expose_vjp(pixels, exposure, &d_exposed);
        let share = self.depth_weight / T::of(pixels.len() as f64);
        let d_pixels = pixels
            .iter()
            .zip(&d_colour)
            .zip(&self.depth)
            .map(|((p, d), &z)| {
                let residual = p[3] - z * p[4];
                value += share * residual * residual;
                let d_depth = T::of(2.0) * share * residual;
                [d[0], d[1], d[2], d_depth, -d_depth * z]
            });
        let d_pixels = d_pixels.collect();
        Loss {
            value,
            pixels: d_pixels,
            exposure: d_exposure,
        }
    }
}

fn geometry<T: Real>(splat: &FixtureSplat) -> Geometry<T> {
    let mean = Vector3::from(splat.mu.map(T::of));
    let (time_mean, log_time_sd) = (T::of(splat.mt[0]), T::of(splat.lst[0]));
    let ls = |k: usize| T::of(splat.ls[k]);
    if let (Some(left), Some(right)) = (splat.ql, splat.qr) {
        return Geometry::Rotor(RotorGaussian {
            mean,
            time_mean,
            log_scale: Vector4::new(ls(0), ls(1), ls(2), log_time_sd),
            left: Vector4::from(left.map(T::of)),
            right: Vector4::from(right.map(T::of)),
        });
    }
    let shape = match splat.q {
        Some(q) => Shape::Anisotropic {
            log_scale: Vector3::new(ls(0), ls(1), ls(2)),
            quat: Vector4::from(q.map(T::of)),
        },
        None => Shape::Isotropic { log_scale: ls(0) },
    };
    Geometry::Gaussian(Gaussian {
        mean,
        shape,
        life: Some(Life {
            time_mean,
            log_time_sd,
            velocity: Vector3::from(splat.v.unwrap_or_default().map(T::of)),
        }),
    })
}

/// A splat of a fixture, or a gradient of one.
pub fn splat<T: Real>(splat: &FixtureSplat) -> Splat<T> {
    Splat {
        geometry: geometry(splat),
        opacity: T::of(splat.o[0]),
        coefficients: splat.sh.iter().map(|k| k.map(T::of)).collect(),
        sh_terms: SH_TERMS,
    }
}

/// The rotor pair of a fixture as a quaternion and a velocity (docs/spec/optimiser.md 1.3 and 1.4).
pub fn converted(splat: &FixtureSplat) -> FixtureSplat {
    let [left, right] =
        [splat.ql, splat.qr].map(|q| Vector4::from(q.expect("the rotor model has rotors")));
    let log_scale = Vector4::new(splat.ls[0], splat.ls[1], splat.ls[2], splat.lst[0]);
    let axes = rotor::rotation(&left, &right) * Matrix4::from_diagonal(&log_scale.map(f64::exp));
    let joint = axes * axes.transpose();
    let (cross, w) = (joint.fixed_view::<3, 1>(0, 3).into_owned(), joint[(3, 3)]);
    let instant: Matrix3<f64> = joint.fixed_view::<3, 3>(0, 0) - cross * cross.transpose() / w;
    let mut eigen = instant.symmetric_eigen();
    if eigen.eigenvectors.determinant() < 0.0 {
        eigen.eigenvectors.column_mut(0).neg_mut();
    }
    let turn =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(eigen.eigenvectors));
    FixtureSplat {
        ls: eigen.eigenvalues.iter().map(|v| 0.5 * v.ln()).collect(),
        lst: [0.5 * w.ln()],
        q: Some([turn.w, turn.i, turn.j, turn.k]),
        v: Some((cross / w).into()),
        ql: None,
        qr: None,
        ..splat.clone()
    }
}

/// The camera of a fixture as one of ours.
pub fn camera(case: &GradientCase) -> m4_core::Camera {
    let [fx, fy, cx, cy] = case.camera.f;
    let w2c = Se3 {
        rotation: Matrix3::from_fn(|i, j| case.camera.rotation[i][j]),
        translation: Vector3::from(case.camera.translation),
    };
    m4_core::Camera {
        intrinsics: m4_core::Intrinsics {
            width: case.width,
            height: case.height,
            fx,
            fy,
            // the oracle's principal point has the half pixel taken off
            cx: cx + 0.5,
            cy: cy + 0.5,
        },
        c2w: w2c.inverse(),
    }
}

/// The frame of a fixture.
pub fn setup<T: Real>(case: &GradientCase) -> Setup<T> {
    Setup {
        camera: Pinhole::new(&camera(case)),
        width: case.width,
        height: case.height,
        t: T::of(case.time),
        background: case.background.map(T::of),
        near: T::of(0.2),
        mip: case.mip,
        period: T::of(case.period),
    }
}

/// A fixture run forward and backward.
pub struct Run<T: Real> {
    pub loss: Loss<T>,
    pub gradient: SceneGradient<T>,
}

/// Runs a fixture through the reference.
pub fn run<T: Real, C: Cutoff>(fixtures: &GradientFixtures, case: &GradientCase) -> Run<T> {
    let splats: Vec<Splat<T>> = case.splats.iter().map(splat).collect();
    let setup = setup(case);
    let rendered = render::<T, C>(&splats, &setup);
    let exposure = case.exposure.map(|row| row.map(T::of));
    let loss = Target::new(fixtures, case).loss(&rendered.image.pixels, case.width, &exposure);
    let gradient = backward::<T, C>(&splats, &setup, &rendered, &loss.pixels);
    Run { loss, gradient }
}

/// A gradient's parameters by name, one vector a kind over all splats.
pub fn by_name<T: Real>(splats: &[Splat<T>]) -> Vec<(&'static str, Vec<f64>)> {
    let mut out: Vec<(&'static str, Vec<f64>)> = Vec::new();
    let mut put = |name: &'static str, values: &mut dyn Iterator<Item = T>| {
        let values = values.map(Real::f64);
        match out.iter_mut().find(|(n, _)| *n == name) {
            Some((_, list)) => list.extend(values),
            None => out.push((name, values.collect())),
        }
    };
    for splat in splats {
        match &splat.geometry {
            Geometry::Rotor(g) => {
                put("mean", &mut g.mean.iter().copied());
                put("time_mean", &mut [g.time_mean].into_iter());
                put("log_scale", &mut g.log_scale.iter().take(3).copied());
                put("log_time_sd", &mut [g.log_scale[3]].into_iter());
                put("left", &mut g.left.iter().copied());
                put("right", &mut g.right.iter().copied());
            }
            Geometry::Gaussian(g) => {
                put("mean", &mut g.mean.iter().copied());
                match &g.shape {
                    Shape::Isotropic { log_scale } => {
                        put("log_scale", &mut [*log_scale].into_iter())
                    }
                    Shape::Anisotropic { log_scale, quat } => {
                        put("log_scale", &mut log_scale.iter().copied());
                        put("quat", &mut quat.iter().copied());
                    }
                }
                if let Some(life) = &g.life {
                    put("time_mean", &mut [life.time_mean].into_iter());
                    put("log_time_sd", &mut [life.log_time_sd].into_iter());
                    put("velocity", &mut life.velocity.iter().copied());
                }
            }
        }
        put("opacity", &mut [splat.opacity].into_iter());
        put("colour", &mut splat.coefficients.iter().flatten().copied());
    }
    out
}
