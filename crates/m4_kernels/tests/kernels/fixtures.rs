//! The reference against the float64 oracle: `fixtures/gradients`, made by `oracles/check_4dgs_grads.py`.

use crate::scenes::{Run, by_name, converted, run, setup, splat};
use m4_core::Real;
use m4_kernels::{
    blend::{self, reference::Hard},
    project,
    reference::{BackwardForm, Setup, render},
};
use m4_testkit::{GradientCase, assert_gradient, gradient_fixtures};

#[test]
fn constants_are_those_of_the_oracle() {
    let fixtures = gradient_fixtures();
    assert_eq!(fixtures.low_pass, project::LOW_PASS);
    assert_eq!(fixtures.jacobian_clamp, project::JACOBIAN_CLAMP);
    assert_eq!(fixtures.alpha_max, blend::ALPHA_MAX);
    assert_eq!(fixtures.alpha_min, blend::ALPHA_MIN);
    assert_eq!(fixtures.t_min, blend::T_MIN);
    for case in &fixtures.cases {
        let limits = project::jacobian_limits(&crate::scenes::camera(case).intrinsics);
        let [x, y] = case.camera.tan.map(|tan| fixtures.jacobian_clamp * tan);
        for (got, want) in limits.into_iter().zip([-x, x, -y, y]) {
            assert!((got - want).abs() < 1e-14, "{got} where {want} was expected");
        }
    }
}

fn check<T: Real>(case: &GradientCase, run: &Run<T>, tolerance: f64) {
    let name = case.name();
    let want: Vec<_> = case.grad_splats.iter().map(splat::<f64>).collect();
    for ((kind, got), (want_kind, want)) in by_name(&run.gradient.splats).into_iter().zip(by_name(&want)) {
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
    check("tau", run.gradient.camera.tau.as_slice(), &case.grad_translation);
    check("omega", run.gradient.camera.omega.as_slice(), &case.grad_rotation);
    check("intrinsics", run.gradient.camera.intrinsics.as_slice(), &case.grad_intrinsics);
    check("exposure", run.loss.exposure.as_flattened(), case.grad_exposure.as_flattened());
    check("background", &run.gradient.background, &case.grad_background);
    let means: Vec<T> = run.gradient.means2d.iter().flat_map(|m| [m.x, m.y]).collect();
    check("means2d", &means, case.grad_means2d.as_flattened());
}

#[test]
fn float64_reference_equals_the_oracle() {
    let fixtures = gradient_fixtures();
    for case in &fixtures.cases {
        for form in [BackwardForm::BackToFront, BackwardForm::Replay] {
            let run = run::<f64, Hard>(&fixtures, case, form);
            let off = (run.loss.value / case.loss - 1.0).abs();
            assert!(off < 1e-10, "{}: loss off by {off:e}", case.name());
            check(case, &run, 1e-7);
            assert!(run.gradient.touched.iter().filter(|&&t| t).count() >= 5, "{}", case.name());
        }
    }
}

#[test]
fn float32_reference_is_within_rounding_of_the_oracle() {
    let fixtures = gradient_fixtures();
    for case in &fixtures.cases {
        for form in [BackwardForm::BackToFront, BackwardForm::Replay] {
            let run = run::<f32, Hard>(&fixtures, case, form);
            let off = (run.loss.value.f64() / case.loss - 1.0).abs();
            assert!(off < 1e-5, "{}: loss off by {off:e}", case.name());
            check(case, &run, 2e-3);
        }
    }
}

/// docs/spec/optimiser.md 1.4: the velocity form is an exact reparametrisation of the rotor form.
#[test]
fn rotor_and_velocity_form_render_the_same_image() {
    let fixtures = gradient_fixtures();
    for case in fixtures.cases.iter().filter(|c| c.model == "rotor") {
        let rotor: Vec<_> = case.splats.iter().map(splat::<f64>).collect();
        let velocity: Vec<_> = case.splats.iter().map(|s| splat::<f64>(&converted(s))).collect();
        for t in [0.0, 0.2, 0.55, 0.8, 1.1] {
            let setup = Setup { t, ..setup::<f64>(case) };
            let [a, b] = [&rotor, &velocity].map(|splats| render::<f64, Hard>(splats, &setup));
            assert_eq!(a.rows, b.rows, "{} at {t}", case.name());
            assert!(a.rows.len() > 3, "{} at {t}", case.name());
            for (x, y) in a.image.pixels.as_flattened().iter().zip(b.image.pixels.as_flattened()) {
                assert!((x - y).abs() < 1e-12, "{} at {t}: {x} and {y}", case.name());
            }
        }
    }
}
