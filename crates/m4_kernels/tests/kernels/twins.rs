//! The CPU twin against the reference, on every SIMD level of the machine: fixtures and random
//! scenes.

use crate::fixtures::{Target, converted};
use crate::twin::{compare, every_level, view};
use m4_core::{Column, SplatLayout, Splats};
use m4_kernels::{Gradients, Renderer, SimdLevel, View, ellipse::reference::CHANNELS};
use m4_testkit::{
    GradientCase, GradientFixtures, SceneSpec, gradient_fixtures, moving_scene, random_camera,
    random_splats,
};

/// Of the largest component. Rounding costs 1e-6 to 1e-5; a contribution that falls on the other
/// side of the cut-off in f32 up to 2e-4.
const TOLERANCE: f64 = 5e-4;

/// A fixture in columns.
fn columns(case: &GradientCase) -> Splats {
    let layout = SplatLayout {
        isotropic: case.model == "isotropic",
        sh_degree: 3,
        time_degree: 2,
    };
    let mut splats = Splats::zeros(layout, 0, case.splats.len());
    for (row, splat) in case.splats.iter().enumerate() {
        let splat = match case.model.as_str() {
            "rotor" => converted(splat),
            _ => splat.clone(),
        };
        let mut set = |column, values: &[f64]| {
            for (k, &value) in values.iter().enumerate() {
                splats.column_mut(column, k)[row] = value as f32;
            }
        };
        set(Column::Mean, &splat.mu);
        set(Column::LogScale, &splat.ls);
        set(Column::Quat, splat.q.as_ref().map_or(&[], |q| q));
        set(Column::Opacity, &splat.o);
        set(Column::Colour, splat.sh.as_flattened());
        set(Column::TimeMean, &splat.mt);
        set(Column::LogTimeSd, &splat.lst);
        set(Column::Velocity, splat.v.as_ref().map_or(&[], |v| v));
    }
    splats
}

fn fixture_view(case: &GradientCase) -> View {
    View {
        camera: crate::fixtures::camera(case),
        t: case.time,
        background: case.background.map(|c| c as f32),
        near: 0.2,
        mip: case.mip,
        period: case.period as f32,
        with_depth: true,
    }
}

/// The loss of one fixture's frame against that of the oracle, and everything else against the
/// reference, which is checked against the oracle itself.
fn check_fixture(fixtures: &GradientFixtures, case: &GradientCase, level: SimdLevel) {
    let (splats, view) = (columns(case), fixture_view(case));
    let mut renderer = Renderer::new(level);
    let frame = renderer.render(&splats, &view);
    let pixels: Vec<[f64; CHANNELS]> = (0..case.width * case.height)
        .map(|i| {
            let at = |plane: &[f32]| f64::from(plane[i]);
            let alpha = 1.0 - at(&frame.transmittance);
            [
                at(&frame.rgb[0]),
                at(&frame.rgb[1]),
                at(&frame.rgb[2]),
                at(&frame.depth),
                alpha,
            ]
        })
        .collect();
    let loss = Target::<f64>::new(fixtures, case).loss(&pixels, case.width, &case.exposure);
    assert!(
        (loss.value / case.loss - 1.0).abs() < 1e-5,
        "{} on {level}: loss {}",
        case.name(),
        loss.value
    );
    compare(&case.name(), level, &splats, &view, TOLERANCE);
}

#[test]
fn fixtures_of_the_oracle() {
    let fixtures = gradient_fixtures();
    every_level(|level| {
        for case in &fixtures.cases {
            check_fixture(&fixtures, case, level);
        }
    });
}

fn layout(isotropic: bool, sh_degree: usize, time_degree: usize) -> SplatLayout {
    SplatLayout {
        isotropic,
        sh_degree,
        time_degree,
    }
}

#[test]
fn random_scenes_of_every_layout_and_odd_sizes() {
    let cases = [
        (layout(false, 0, 0), 64, 48),
        (layout(true, 0, 0), 37, 29),
        (layout(false, 3, 2), 33, 25),
        (layout(false, 1, 0), 16, 8),
        (layout(true, 2, 1), 7, 5),
        (layout(false, 0, 2), 1, 1),
        (layout(false, 0, 0), 130, 3),
        (layout(true, 1, 2), 3, 70),
    ];
    every_level(|level| {
        for (seed, (layout, width, height)) in cases.into_iter().enumerate() {
            let camera = random_camera(seed as u64, width, height);
            let spec = SceneSpec {
                layout,
                n_static: 60 + 7 * seed,
                n_dynamic: 45 + 5 * seed,
                ..SceneSpec::default()
            };
            let splats = random_splats(seed as u64, &camera, &spec);
            for mip in [false, true] {
                let name = format!("scene {seed}, {width} x {height}, mip {mip}");
                compare(
                    &name,
                    level,
                    &splats,
                    &View {
                        mip,
                        ..view(camera)
                    },
                    TOLERANCE,
                );
            }
        }
    });
}

/// Of a single splat the gradient with respect to its centre in the image is that with respect to
/// the principal point.
#[test]
fn the_image_gradient_of_one_splat_is_that_of_the_principal_point() {
    every_level(|level| {
        for (n_static, n_dynamic) in [(1, 0), (0, 1)] {
            let camera = random_camera(41, 30, 20);
            let spec = SceneSpec {
                n_static,
                n_dynamic,
                sd_px: [3.0, 5.0],
                ..SceneSpec::default()
            };
            let splats = random_splats(8, &camera, &spec);
            let mut renderer = Renderer::new(level);
            let frame = renderer.render(&splats, &view(camera));
            let plane = |k: usize| {
                (0..frame.rgb[0].len())
                    .map(|i| ((i * (k + 3)) % 7) as f32 - 3.0)
                    .collect()
            };
            let gradient = [plane(0), plane(1), plane(2)];
            let mut out = Gradients {
                image: Some(Vec::new()),
                ..Gradients::default()
            };
            renderer.backward(&splats, &gradient, true, &mut out);
            let [.., x, y] = out.camera.intrinsics;
            let want = (15.0 * x).hypot(10.0 * y);
            let got = f64::from(out.image.unwrap()[0]);
            assert!(
                out.touched == [1] && want > 0.0 && (got / want - 1.0).abs() < 1e-5,
                "{got} for {want}"
            );
        }
    });
}

#[test]
fn only_static_or_only_dynamic_splats() {
    every_level(|level| {
        for (n_static, n_dynamic) in [(70, 0), (0, 70), (1, 0), (0, 1), (16, 16), (17, 15)] {
            let camera = random_camera(40, 30, 20);
            let spec = SceneSpec {
                n_static,
                n_dynamic,
                ..SceneSpec::default()
            };
            let splats = random_splats(4, &camera, &spec);
            let name = format!("{n_static} static, {n_dynamic} dynamic");
            compare(&name, level, &splats, &view(camera), TOLERANCE);
        }
    });
}

#[test]
fn splats_of_a_fraction_of_a_pixel_and_of_the_whole_image() {
    every_level(|level| {
        for (seed, sd_px) in [[0.01, 0.3], [20.0, 60.0]].into_iter().enumerate() {
            let camera = random_camera(50 + seed as u64, 45, 35);
            let spec = SceneSpec {
                sd_px,
                ..SceneSpec::default()
            };
            let splats = random_splats(seed as u64, &camera, &spec);
            compare(
                &format!("{sd_px:?} pixels"),
                level,
                &splats,
                &view(camera),
                TOLERANCE,
            );
        }
    });
}

#[test]
fn a_deep_opaque_stack() {
    // pixels end early: the replay subtracts nearly all of the colour
    every_level(|level| {
        let camera = random_camera(61, 40, 30);
        let spec = SceneSpec {
            n_static: 400,
            n_dynamic: 200,
            sd_px: [4.0, 12.0],
            logit: [1.0, 6.0],
            ..SceneSpec::default()
        };
        let splats = random_splats(6, &camera, &spec);
        compare("stack", level, &splats, &view(camera), TOLERANCE);
    });
}

#[test]
fn without_depth_the_colours_are_the_same() {
    every_level(|level| {
        let camera = random_camera(71, 50, 20);
        let splats = random_splats(7, &camera, &SceneSpec::default());
        let flat = View {
            with_depth: false,
            ..view(camera)
        };
        compare("no depth", level, &splats, &flat, TOLERANCE);
        let rgb = Renderer::new(level)
            .render(&splats, &view(camera))
            .rgb
            .clone();
        let frame = Renderer::new(level).render(&splats, &flat).clone();
        assert_eq!(frame.rgb, rgb);
        assert!(frame.depth.is_empty());
    });
}

#[test]
fn a_moving_scene_at_every_frame() {
    let scene = moving_scene(m4_core::Intrinsics::centred(48, 36, 40.0), 6);
    every_level(|level| {
        for (i, &camera) in scene.cameras.iter().enumerate() {
            let at = View {
                t: i as f64,
                ..view(camera)
            };
            compare(&format!("frame {i}"), level, &scene.splats, &at, TOLERANCE);
        }
    });
}
